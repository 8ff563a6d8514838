// The state of a comparison of laboratories: who is missing, then who agrees.
import assert from 'node:assert/strict';
import {createHash} from 'node:crypto';
import {mkdirSync, readFileSync, writeFileSync} from 'node:fs';
import path from 'node:path';
import {abcal, barriers, begin, complainsOfNothing, inGerman, noEnglish, pictureOf, says, served} from './page_test.mjs';
import {SIZES} from './served_page.mjs';

const SYMBOLS = ['s_u', 's_v', 's_w', 'phi_uv', 'phi_vw', 'phi_wu', 'O_u', 'O_v', 'O_w'];
const LABS = ['LAB1', 'LAB2', 'LAB3'];
const inFolder = (name) => path.join(served.folder, name);
const add = (...words) => abcal('pilot', 'add', 'c.toml', ...words);

// Every value begins with the digits 0.7391. LAB3 differs by 14 standard uncertainties.
function prepare() {
  mkdirSync(served.folder, {recursive: true});
  const more = LABS.map((name) => `[[participant]]\nname = "${name}"\n[[measurement]]\nparticipant = "${name}"\ndate = ${name === 'LAB3' ? '2026-03-02' : '2999-01-01'}\n`).join('');
  writeFileSync(inFolder('c.toml'), `schema = "abcal.comparison/1"\n[comparison]\nname = "CCAUV.A-X1"\npilot = "LAB1"\nitem_serial_number = "17"\nresponse_unit = "V"\ndraws = 1000\n${more}`
    + '[[correlation_bound]]\nname = "P-3"\nparticipants = ["LAB1", "LAB2"]\ncorrelation = 0.5\n');
  for (const name of LABS)
    writeFileSync(inFolder(`${name}.csv`), ['# response_unit: V', '# item_serial_number: 17', `quantity,value,${SYMBOLS.join(',')}`,
      ...SYMBOLS.map((symbol, i) => [symbol, {LAB1: 0.7391, LAB2: 0.739101, LAB3: 0.73924}[name], ...SYMBOLS.map((_, k) => (i === k ? 1e-10 : 0))].join(','))].join('\n'));
  add('LAB1.csv', '--participant', 'LAB1');
  add('--participant', 'LAB2', '--sha256', createHash('sha256').update(readFileSync(inFolder('LAB2.csv'))).digest('hex'));
}
const step = begin({prepare});

async function look(name) {
  for (const [size, viewport] of Object.entries({desk: SIZES.desk, phone: SIZES.phone})) {
    await served.page.setViewportSize(viewport);
    await pictureOf(served.page, `comparisons-${name}-${size}`);
    assert.ok(await served.page.evaluate(() => document.documentElement.scrollWidth <= innerWidth), `nothing is wider than the screen, ${size}`);
  }
  await served.page.setViewportSize(SIZES.desk);
}

step('shows who is missing, and no value', async (page) => {
  await page.locator('#to-comparisons').click();
  await page.locator('#comparisons-body tbody tr').countIs(3);
  await says('#comparisons-body .card > p', /^Pilot: LAB1\. 2 of 3 results are in\. No value is shown before all are in\.$/);
  const states = await page.evaluate(() => [...document.querySelectorAll('#comparisons-body td:nth-child(3)')].map((cell) => cell.textContent));
  assert.match(states[0], /^registered and revealed, \d{4}-\d\d-\d\d$/);
  assert.match(states[1], /^registered, file missing, /);
  assert.equal(states[2], 'missing since the planned day');
  assert.ok(!(await page.evaluate(() => document.body.textContent)).includes('7391'));
  assert.deepEqual(await barriers(), []);
  await look('open');
});

step('shows who agrees when all results are in, with the report', async (page) => {
  add('LAB2.csv', '--participant', 'LAB2');
  add('LAB3.csv', '--participant', 'LAB3');
  await page.locator('nav a[href="#live"]').click();
  await page.locator('#to-comparisons').click();
  await says('#comparisons-body .outcome-of strong', /^LAB3 \(\w+\) differs from the others, which agree\.$/);
  await says('#comparisons-body .card', /Draft A is not agreed with by: LAB1, LAB2, LAB3\./);
  const draft = await served.download(() => page.locator('.outcome-of a').click());
  assert.match(readFileSync(draft, 'utf8'), /Draft A: CCAUV\.A-X1/);
  assert.deepEqual(await barriers(), []);
  await look('analysed');
});

step('does so in German', async (page) => {
  await inGerman();
  await page.locator('#to-comparisons').click();
  await says('#comparisons-body .outcome-of strong', /^LAB3 \(\w+\) weicht von den anderen ab, die übereinstimmen\.$/);
  await says('#comparisons-body li', /^P-3: Die Korrelation von LAB1, LAB2 in s_u .* liegt zwischen 0 und 0[.,]5\.$/);
  await noEnglish();
  await look('german');
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
