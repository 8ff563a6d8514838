// With the keyboard alone: Tab leads through all views, and the focus is always visible.
import assert from 'node:assert/strict';
import {browserName} from './served_page.mjs';
import {abcal, begin, complainsOfNothing, eventually, served, unseen} from './page_test.mjs';

const step = begin({pace: 10, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});

// Presses Tab, or Shift+Tab, until it leaves the page. Returns the number of elements on the way.
async function tour(page, {back = false} = {}) {
  for (let i = 0; i < 150; ++i) {
    if (back) await page.keyboard.down('Shift');
    await page.keyboard.press('Tab');
    if (back) await page.keyboard.up('Shift');
    const why = await eventually(async () => {  // The page may still move after the change of focus.
      const now = await unseen(page);
      assert.ok(now === null || (now === 'nothing has the focus' && i > 0), `after ${i} steps: ${now}`);
      return now;
    });
    if (why) return i;
  }
  throw new Error('Tab does not come to an end');
}

for (const view of ['live', 'queue', 'bench', 'runs', 'runs/first.run', 'compare', 'chart']) {
  step(`Tab leads through ${view} and back, and one sees where`, async () => {
    const page = await served.newPage();  // A page in which nothing has had the focus.
    await page.goto(`${served.address}#${view}`);
    await page.waitForFunction(() => document.getElementById('link').textContent === 'Connected');
    await page.locator({live: '#take-control:enabled', queue: '#queue-add', bench: '#ports', runs: '#run-table a', 'runs/first.run': '#certificate [lang=en]', compare: '#compare-table p', chart: '#chart-words'}[view]).waitFor();
    await page.waitForFunction(() => document.getElementById('run-loading').textContent === '');
    await page.setViewportSize({width: 683, height: 384});  // A size at which the banner takes most of the room.
    await page.waitForFunction(() => innerWidth === 683 && parseFloat(document.documentElement.style.scrollPaddingTop) === document.getElementById('top').offsetHeight + 8);
    const there = await tour(page);
    assert.ok(there > 8, String(there));
    // In Firefox, puppeteer-core cannot leave the browser's own controls again.
    if (browserName === 'chromium' && ['live', 'bench', 'runs/first.run'].includes(view)) assert.ok(await tour(page, {back: true}) >= there - 1);
    await page.close();
  });
}

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
