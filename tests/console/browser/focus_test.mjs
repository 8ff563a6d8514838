// With the keyboard alone: Stop is first, and the focus is never lost, always visible, and never under the banner.
import assert from 'node:assert/strict';
import {begin, complainsOfNothing, ENDLESS, eventually, served, stateIs, unseen} from './page_test.mjs';

const step = begin({pace: 5, bench: ENDLESS});
const focused = (page) => page.evaluate(() => document.activeElement?.id || document.activeElement?.tagName);
const begins = (page) => page.evaluate(() => { document.activeElement?.blur(); getSelection().removeAllRanges(); scrollTo(0, 0); });

step('a view that is chosen gets the focus, and one sees it', async (page) => {
  for (const view of ['runs', 'live']) {
    await page.locator(`nav a[href="#${view}"]`).press('Enter');
    await page.waitForFunction((hash) => location.hash === hash && document.activeElement.id === 'main', `#${view}`);
    await eventually(async () => assert.equal(await unseen(page), null));
  }
});

step('keeps the focus in what it steers, through all that a run does', async (page) => {
  const stays = (where) => eventually(async () => {
    assert.equal(await unseen(page), null, where);
    assert.ok(await page.evaluate(() => document.activeElement.closest('#steering') !== null), `${where}: ${await focused(page)}`);
  });
  const focusIs = (id) => page.waitForFunction((expected) => document.activeElement?.id === expected, id);
  await page.locator('#take-control').press('Enter');
  await page.locator('#do-start:enabled').press('Enter');
  await page.locator('#confirm-yes:enabled').waitFor();
  await page.keyboard.press('Tab');
  await focusIs('confirm-yes');
  await page.keyboard.press('Enter');
  await page.locator('#do-hold:enabled').waitFor();
  await stays('a run begins');
  await page.locator('#do-hold').press('Enter');
  await page.locator('#do-hold').becomesDisabled();
  await stays('it is held');
  await stateIs(/^Held/);
  await begins(page);
  await page.reload();
  await served.entered();
  await page.locator('#do-stop:enabled').waitFor();
  await page.keyboard.press('Tab');
  await focusIs('do-stop');  // Stop is first.
  await page.keyboard.press('Enter');
  await stateIs(/^The run is interrupted/);
  await page.locator('#do-stop').becomesDisabled();
  await page.waitForFunction(() => document.activeElement !== document.body && !document.activeElement.disabled);
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
