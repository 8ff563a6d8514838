// Several items: the start form, a card for each while the run goes on, and the result of each.
import assert from 'node:assert/strict';
import {readFileSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {abcal, barriers, begin, complainsOfNothing, confirmDialog, eventually, look, noEnglish, says, served, stateIs} from './page_test.mjs';

const examples = path.join(path.dirname(fileURLToPath(import.meta.url)), '../../../docs/examples');
const example = readFileSync(path.join(examples, 'tray.toml'), 'utf8');
const tray = example.slice(0, example.lastIndexOf('[[item]]', example.indexOf('# item 4')))
  .replace('bench with a tray', 'Bench 5').replace('steps = 24\nstep_deg = 15.0', 'steps = 12\nstep_deg = 30.0').replace('dwell_readings = 300', 'dwell_readings = 50');
const step = begin({pace: 30, bench: tray, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});

step('the start form names the items, and asks what is to be done with those that are not there', async (page) => {
  await page.locator('#take-control').click();
  await page.locator('#do-start:enabled').click();
  await page.locator('#confirm-yes:enabled').waitFor();
  await page.locator('#start-items li').countIs(3);
  await says('#start-items', /6284\.000002/);
  assert.ok(await page.locator('#start-serial-number').isHidden(), 'the bench file says which items there are');
  assert.deepEqual(await barriers(), []);
  await page.locator('#start-without-missing').check();
  await look('start-form-items');
  await confirmDialog();
});

step('each item has a card while the run goes on', async (page) => {
  await page.locator('#items > li').countIs(3);
  await page.locator('#items > li', {hasText: /Item 3: 6284\.000003.*[1-9]\d* of \d+ angles.*[+−]\d\.\d{6}/}).waitFor();
  await look('items-live');
  await stateIs(/^The run is complete/);
  await eventually(async () => {
    for (const words of await page.locator('#items > li').allInnerTexts()) assert.match(words, /\b(\d+) of \1 angles/);
  });
  assert.deepEqual(await barriers(), []);
});

step('each item has a result of its own, and downloads', async (page) => {
  await page.goto(`${served.address}#runs/first.run`);
  await says('#run-item', 'Result of item 1');
  await page.locator('#result-items a', {hasText: 'Result of item 3'}).click();
  await says('#run-item', 'Result of item 3');
  await page.locator('#result-items [data-item="3"] a[aria-current]').waitFor();
  await page.waitForFunction(() => document.activeElement?.id === 'main');
  const printed = JSON.parse(abcal('analyse', 'first.run', '--item', '3', '--estimator', 'abc', '--json'));
  const shown = await page.locator('#estimators tbody tr', {hasText: /^O_u/}).evaluateAll((rows) => [...rows[0].children].map((cell) => cell.textContent));
  const value = Number(shown[4].replace('−', '-')), digits = (shown[4].split('.')[1] ?? '').length;
  assert.ok(Math.abs(value - printed.offset[0].value) <= 0.5001 * 10 ** -digits, `${shown} for ${printed.offset[0].value}`);
  const csv = await served.download(() => page.getByRole('link', {name: 'Averaged readings (CSV)'}).click());
  assert.match(path.basename(csv), /^first-item-3-readings/);
  assert.deepEqual(await barriers(), []);
  await look('items-result');
  await page.locator('#language').click();
  await says('#run-item', 'Ergebnis von Gegenstand 3');
  await noEnglish();
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
