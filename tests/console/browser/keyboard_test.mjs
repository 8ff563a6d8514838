// With the keyboard alone: Stop is first, focus is always somewhere, always seen, and never under the banner.
import assert from 'node:assert/strict';
import {browserName} from './served_page.mjs';
import {abcal, begin, complainsOfNothing, served, stateIs} from './page_test.mjs';

const step = begin({pace: 10, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});
const focused = (page) => page.evaluate(() => document.activeElement?.id || document.activeElement?.tagName);

// Why a person would not see where the focus is; null if all is well.
const unseen = (page) => page.evaluate(() => {
  const element = document.activeElement, name = element?.outerHTML.slice(0, 100);
  if (!document.hasFocus() || !element || element === document.body) return 'nothing has the focus';  // Or the browser's own controls.
  if (element.matches(':disabled')) return `it cannot be used: ${name}`;
  const {outlineStyle, outlineWidth} = getComputedStyle(element);
  if (outlineStyle === 'none' || parseFloat(outlineWidth) < 2) return `no outline: ${name}`;
  const {left, right, top, bottom} = element.getBoundingClientRect(), banner = document.getElementById('top');
  const [x, y] = [(left + right) / 2, Math.min(Math.max((top + bottom) / 2, banner.getBoundingClientRect().bottom + 2), innerHeight - 2)];
  if (banner.contains(element) || element.classList.contains('skip')) return null;
  if (bottom <= banner.getBoundingClientRect().bottom || top >= innerHeight) return `out of sight: ${name}`;
  const hit = document.elementFromPoint(x, y);
  return element.contains(hit) || hit?.contains(element) ? null : `under ${hit?.outerHTML.slice(0, 60)}: ${name}`;
});

// All that Tab leads to, or Shift+Tab, until it leaves the page; how many.
async function tour(page, {back = false} = {}) {
  for (let i = 0; i < 150; ++i) {
    if (back) await page.keyboard.down('Shift');
    await page.keyboard.press('Tab');
    if (back) await page.keyboard.up('Shift');
    const why = await unseen(page);
    if (why === 'nothing has the focus' && i > 0) return i;
    assert.equal(why, null, `after ${i} steps`);
  }
  throw new Error('Tab does not come to an end');
}
const begins = (page) => page.evaluate(() => { document.activeElement?.blur(); getSelection().removeAllRanges(); scrollTo(0, 0); });

for (const view of ['live', 'queue', 'bench', 'runs', 'runs/first.run', 'compare', 'chart']) {
  step(`Tab leads through ${view} and back, and one sees where`, async () => {
    const page = await served.newPage();  // Where nothing has had the focus.
    await page.goto(`${served.address}#${view}`);
    await page.waitForFunction(() => document.getElementById('link').textContent === 'Connected');
    await page.locator({live: '#take-control:enabled', queue: '#queue-add', bench: '#ports', runs: '#run-table table', 'runs/first.run': '#estimators', compare: '#compare-form', chart: '#chart-words'}[view]).waitFor();
    await page.setViewportSize({width: 683, height: 384});  // Where the banner takes most of the room.
    const there = await tour(page);
    assert.ok(there > 8, String(there));
    // Of Firefox, puppeteer-core cannot leave the browser's own controls again.
    if (browserName === 'chromium') assert.ok(await tour(page, {back: true}) >= there - 1);
    await page.close();
  });
}

step('a view that is chosen gets the focus, and one sees it', async (page) => {
  for (const view of ['runs', 'live']) {
    await page.locator(`nav a[href="#${view}"]`).press('Enter');
    await page.waitForFunction(() => document.activeElement.id === 'main');
    assert.equal(await unseen(page), null);
  }
});

step('keeps the focus in what it steers, through all that a run does', async (page) => {
  const stays = async (where) => {
    assert.equal(await unseen(page), null, where);
    assert.ok(await page.evaluate(() => document.activeElement.closest('#steering') !== null), `${where}: ${await focused(page)}`);
  };
  await page.locator('#take-control').press('Enter');
  await page.locator('#do-start:enabled').press('Enter');
  await page.locator('#confirm-yes:enabled').waitFor();
  await page.keyboard.press('Tab');
  assert.equal(await focused(page), 'confirm-yes');
  await page.keyboard.press('Enter');
  await page.locator('#do-hold:enabled').waitFor();
  await stays('a run begins');
  await page.locator('#do-hold').press('Enter');
  await page.waitForFunction(() => document.getElementById('do-hold').disabled);
  await stays('it is held');
  await stateIs(/^Held/);
  await begins(page);
  await page.reload();
  await served.entered();
  await page.locator('#do-stop:enabled').waitFor();
  await page.keyboard.press('Tab');
  assert.equal(await focused(page), 'do-stop', 'first');
  await page.keyboard.press('Enter');
  await stateIs(/^The run is interrupted/);
  await page.waitForFunction(() => document.getElementById('do-stop').disabled);
  await page.waitForFunction(() => document.activeElement !== document.body && !document.activeElement.disabled);
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
