// Two runs of an item side by side, and its control chart.
import assert from 'node:assert/strict';
import {abcal, begin, complainsOfNothing, confirmDialog, look, says, stateIs} from './page_test.mjs';

const step = begin({pace: 40, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});

step('compares two runs and shows the control chart of an item', async (page) => {
  await page.getByRole('button', {name: 'Take control'}).click();
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await stateIs(/^The run is complete/);
  await page.locator('nav a[href="#compare"]').click();
  await page.locator('#compare-form button').click();
  await page.locator('#compare-words').waitFor();
  await page.locator('#compare-table .scroll-x tbody tr').countIs(9);
  await look('compare');
  await page.locator('nav a[href="#chart"]').click();
  await page.locator('#chart-words').waitFor();
  await page.locator('#chart-body .scroll-x tbody tr').countIs(2);
  await says('#chart-words', /^Centre [\d.]+ g\/g_loc; limits/);
  // Centre and limits have words, and do not differ by colour alone.
  const levels = await page.evaluate(() => document.querySelector('#chart-body .plot').chart.levels.map(({words, dash}) => [words, dash.length]));
  assert.deepEqual(levels, [['centre', 0], ['limits', 2], ['', 2]]);
  await look('chart');
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
