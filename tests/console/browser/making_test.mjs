// Requests that take seconds can be cancelled: the analysis of a run, and its PDF. The test holds the request up until then.
import assert from 'node:assert/strict';
import {abcal, begin, complainsOfNothing, eventually, says, served} from './page_test.mjs';

const step = begin({pace: 10, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});
let failed = 0;

// Holds up requests whose address ends with `end`, until letThrough() is called.
async function heldUp(page, end) {
  const held = [];
  let holds = true;
  await page.page.setRequestInterception(true);
  const hold = (request) => { if (holds && request.url().endsWith(end)) held.push(request); else request.continue(); };
  page.page.on('request', hold);
  return {held, letThrough: async () => {
    holds = false;
    for (const request of held) await request.continue().catch(() => {});  // The page has cancelled it.
    page.page.off('request', hold);
    await page.page.setRequestInterception(false);
  }};
}

step('the analysis of a run is cancelled, and made when it is asked for again', async (page) => {
  page.page.on('requestfailed', () => ++failed);
  const {held, letThrough} = await heldUp(page, '/result');
  await served.goTo('runs');
  await page.getByRole('link', {name: 'first.run'}).click();
  await says('#run-detail [role=status]', 'Reading and analysing first.run');
  await eventually(() => assert.equal(held.length, 1));
  await page.locator('#run-detail button.cancel').click();
  await says('#run-detail [role=status]', 'Cancelled.');
  await eventually(() => assert.equal(failed, 1));  // The request itself is cancelled, not only its result ignored.
  await letThrough();
  await served.goTo('runs');
  await page.getByRole('link', {name: 'first.run'}).click();
  await page.locator('#estimators').waitFor();
});

step('a PDF is cancelled', async (page) => {
  const link = page.locator('a.button[href$="report.pdf"]');
  if (!await link.count()) return;  // WeasyPrint is not installed.
  const {held, letThrough} = await heldUp(page, '/report.pdf');
  await link.click();
  await page.getByText('The PDF is being made.').waitFor();
  await eventually(() => assert.equal(held.length, 1));
  await page.locator('#run-detail button.cancel').click();
  await page.getByText('Cancelled.').waitFor();
  await eventually(() => assert.equal(failed, 2));
  await letThrough();
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
