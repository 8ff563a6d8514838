// Contents that appear later move no earlier contents of the page; Chromium measures it.
import assert from 'node:assert/strict';
import {abcal, begin, served} from './page_test.mjs';

// The last element that a view shows.
const LATE = {runs: '#run-table table', 'runs/first.run': '#estimators', chart: '#chart-words'};
const step = begin({pace: 10, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});

step('what comes later moves nothing (cumulative layout shift)', async () => {
  for (const view of ['live', 'runs', 'runs/first.run', 'compare', 'chart', 'kiosk']) {
    const page = await served.newPage();
    await page.goto(`${served.address}#${view}`);
    await page.waitForFunction(() => document.getElementById('link').textContent === 'Connected');
    if (LATE[view]) await page.locator(LATE[view]).waitFor();
    const shift = await page.evaluate(() => new Promise((resolve) => {
      new PerformanceObserver((list) => resolve(list.getEntries().reduce((sum, {value}) => sum + value, 0))).observe({type: 'layout-shift', buffered: true});
      setTimeout(() => resolve(0), 500);  // Without a shift there is no event.
    }));
    assert.ok(shift < 0.05, `${view}: ${shift}`);
    await page.close();
  }
});
