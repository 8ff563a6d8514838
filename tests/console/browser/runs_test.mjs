// A long list of runs: its columns, its search and its pages.
import assert from 'node:assert/strict';
import {copyFileSync} from 'node:fs';
import path from 'node:path';
import {abcal, begin, complainsOfNothing, look, says, served} from './page_test.mjs';

const RUNS = 110;
const step = begin({
  pace: 10,
  prepare() {
    abcal('run', 'bench.toml', '-o', 'run-001.run');
    for (let i = 2; i <= RUNS; ++i) {
      for (const end of ['.run', '.run.results'])
        copyFileSync(path.join(served.folder, `run-001${end}`), path.join(served.folder, `run-${String(i).padStart(3, '0')}${end}`));
    }
  },
});
const countIs = (words) => says('#run-count', words);

step('shows a hundred at a time, with result and operator', async (page) => {
  await served.goTo('runs');
  await countIs(`${RUNS} of ${RUNS} runs; here 1 to 100`);
  await page.waitForFunction(() => document.getElementById('run-loading').textContent === '');
  const cells = await page.locator('#run-table tbody tr').first().locator('td').allInnerTexts();
  assert.ok(cells.includes('Usable'), cells.join(' | '));
  assert.ok(cells.includes('N. N. (stated, not verified)'), cells.join(' | '));
  await page.getByRole('button', {name: 'Newer runs'}).becomesDisabled();
  await page.getByRole('button', {name: 'Older runs'}).click();
  await countIs(`${RUNS} of ${RUNS} runs; here 101 to ${RUNS}`);
  await page.locator('#run-table tbody tr').countIs(RUNS - 100);
  await look('long-list');
});

step('searches all pages', async (page) => {
  await page.locator('#run-search').fill('run-07 usable');
  await countIs(`10 of ${RUNS} runs`);
  await page.getByRole('button', {name: 'Older runs'}).countIs(0);
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
