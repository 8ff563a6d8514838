// A long list of runs: its columns, its search and its pages.
import assert from 'node:assert/strict';
import {copyFileSync} from 'node:fs';
import path from 'node:path';
import {abcal, BENCH, begin, complainsOfNothing, eventually, look, says, served} from './page_test.mjs';

const RUNS = 110;
const step = begin({
  pace: 10,
  prepare() {
    abcal('run', 'bench.toml', '-o', 'run-001.run');
    served.describe(BENCH.replace('noise = 1e-4', 'seed = 2\nnoise = 1e-4'));
    abcal('run', 'bench.toml', '-o', 'run-002.run');
    served.describe(BENCH);
    // Neighbours in the list are no copies of each other.
    for (let i = 3; i <= RUNS; ++i) {
      for (const end of ['.run', '.run.results'])
        copyFileSync(path.join(served.folder, `run-00${2 - i % 2}${end}`), path.join(served.folder, `run-${String(i).padStart(3, '0')}${end}`));
    }
  },
});
const countIs = (words) => says('#run-count', words);

step('shows a hundred at a time, with result and operator', async (page) => {
  await served.goTo('runs');
  await countIs(`${RUNS} of ${RUNS} runs; here 1 to 100`);
  await page.waitForFunction(() => document.getElementById('run-loading').textContent === '');
  const cells = await page.locator('#run-table tbody tr').first().locator('td').allInnerTexts();
  assert.ok(cells.includes('✓ Usable'), cells.join(' | '));
  assert.ok(cells.includes('N. N. (stated, not verified)'), cells.join(' | '));
  await page.getByRole('button', {name: 'Earlier rows'}).becomesDisabled();
  await page.getByRole('button', {name: 'Later rows'}).click();
  await countIs(`${RUNS} of ${RUNS} runs; here 101 to ${RUNS}`);
  await page.locator('#run-table tbody tr').countIs(RUNS - 100);
  await look('long-list');
});

step('searches all pages', async (page) => {
  await page.locator('#run-search').fill('run-07 usable');
  await countIs(`10 of ${RUNS} runs`);
  await page.getByRole('button', {name: 'Later rows'}).countIs(0);
});

step('sorts by a heading, over all pages', async (page) => {
  await page.locator('#run-search').fill('');
  const first = (name) => page.locator('#run-table tbody th').first().says(name);
  await page.locator('[data-sort=name]').click();
  await first('run-001.run');
  assert.equal(await page.evaluate(() => document.activeElement.dataset.sort), 'name');
  await page.locator('[data-sort=name]').click();
  await first(`run-${RUNS}.run`);
  await page.locator('th[aria-sort=descending]').countIs(1);
});

step('comes from the console in pages', async (page) => {
  const {bytes, rows} = await page.evaluate(async () => {
    const body = await (await fetch('/runs?count=20&search=run')).text();
    return {bytes: body.length, rows: JSON.parse(body).runs.length};
  });
  assert.equal(rows, 20);
  assert.ok(bytes < 20 * 700, `${bytes} bytes`);
  assert.equal(await page.evaluate(async () => (await fetch('/runs?rows=20')).status), 404);
  await eventually(() => assert.equal(served.problems.length, 1));
  assert.match(served.problems.pop(), /404/);  // The browser reports the refused request.
});

step('two runs of the list are chosen to be compared, at an address that can be sent', async (page) => {
  await page.locator('#run-search').fill('run-07');
  await countIs(`10 of ${RUNS} runs`);
  await page.locator('.compare-run', {hasText: 'Compare'}).first().click();
  await page.locator('.compare-run', {hasText: 'With this one'}).first().click();
  await page.waitForFunction(() => /^#compare\/run-07\d\.run\/run-07\d\.run$/.test(location.hash));
  await page.locator('#compare-words').waitFor();
  await page.locator('#compare-table .scroll-x tbody tr').countIs(9);
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
