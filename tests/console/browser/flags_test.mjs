// From a fault to its readings: an output that is stuck during a run flags an angle, and two clicks lead from the flag to the readings.
import assert from 'node:assert/strict';
import {BENCH, begin, clicksToReadings, complainsOfNothing, confirmDialog, eventually, look, served, stateIs, text} from './page_test.mjs';

// Some time into the run the output v keeps its value for some angles.
const bench = `${BENCH}
[[fault]]
kind = "stuck-output"
output = "v"
at_s = 75.0
for_s = 12.0
`;
const step = begin({pace: 20, bench});
const chartOf = (page, selector) => page.evaluate((css) => { const {chart} = document.querySelector(css); return {points: chart.values[0].length, values: chart.values.slice(1), holder: document.querySelector(css).clientWidth}; }, selector);

step('a stuck output flags an angle; two clicks lead to its readings', async (page) => {
  await page.locator('#try-demo:enabled').click();  // No run is in the folder yet: one press takes control and opens the start form.
  await confirmDialog();
  await page.locator('#flagged a').waitFor();
  await page.locator('#flags').says(/stuck output/);
  assert.equal(await clicksToReadings('stuck output'), 2);
  await eventually(async () => assert.ok((await chartOf(page, '#angle-readings .plot')).points >= 200));
  const {values: [u, v]} = await chartOf(page, '#angle-readings .plot');
  assert.ok(new Set(v).size < new Set(u).size / 4, 'the output v is seen to be stuck');
  await page.locator('#angle-readings button', {hasText: 'Close'}).click();
  await stateIs(/^The run is complete/);
});

step('a residual has its digits and z under the pointer', async (page) => {
  await page.locator('nav a[href="#runs"]').click();
  await page.locator('#run-table tbody a').first().click();
  await page.locator('#residuals .plot').first().waitFor();
  await page.waitForFunction(() => document.querySelector('#residuals .plot').chart?.values[0].length > 10);
  await page.evaluate(() => document.querySelector('#residuals').scrollIntoView({block: 'center'}));
  const box = await (await page.locator('#residuals .plot').first().one('visible')).boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 3);
  await eventually(async () => {
    const cells = await page.evaluate(() => [...document.querySelectorAll('#residuals .plot')].map(({chart}) => [...chart.plot.root.querySelectorAll('.u-value')].map((cell) => cell.textContent)));
    assert.match(cells[0][1], /^[+−]\d+(\.\d+)?(e−\d)? g\nz [+−]\d+\.\d$/);
    assert.ok(cells.every(([at]) => at === cells[0][0]), `charts share the crosshair: ${JSON.stringify(cells)}`);
  });
  await page.locator('#residuals-against').selectOption('time');
  await page.locator('#residuals .plot').countIs(2);
  await look('residuals');
});

step('all readings of the run are few points, and zoom works by key in both directions', async (page) => {
  await page.locator('#all-readings summary').click();
  await page.locator('#all-readings .plot').waitFor();
  const {points, holder} = await chartOf(page, '#all-readings .plot');
  assert.match(await text('#all-readings p'), /^9\d{3} readings; drawn: lowest and highest of \d+ parts\.$/);
  assert.ok(points > 40 && points <= 2 * holder, `${points} points in ${holder} px`);
  const shown = () => page.evaluate(() => { const {chart} = document.querySelector('#all-readings .plot'); return [...chart.shownX, ...chart.shownY]; });
  const before = await shown();
  await page.locator('#all-readings .plot').press('PageUp');
  await eventually(async () => { const [, , low, high] = await shown(); assert.ok(Math.abs((high - low) / (before[3] - before[2]) - 0.5) < 1e-6); });
  await page.locator('#all-readings .plot').press('+');
  await eventually(async () => { const [from, to, low, high] = await shown(); assert.ok(to - from < 0.6 * (before[1] - before[0]) && high - low < 0.6 * (before[3] - before[2])); });
  await page.locator('#all-readings .plot').press('0');
  await eventually(async () => assert.deepEqual(await shown(), before));
});

step('the run plays again, and REPLAY stands over it', async (page) => {
  const points = () => page.evaluate(() => document.querySelector('#residuals .plot').chart.values[0].length);
  const all = await points();
  const marks = await page.evaluate(() => document.querySelectorAll('#replay-flags option').length);
  assert.ok(marks >= 1 && marks < 5, `${marks} marks`);
  await page.locator('#replay-speed').selectOption('10');
  await page.locator('#replay-play').click();
  await page.locator('.replay-badge', {hasText: 'REPLAY'}).waitFor();
  await eventually(async () => assert.ok(await points() < all));
  await page.locator('#replay-where').says(/^\d+.* of 47 angles, \d flagged$/);
  await page.locator('#replay-speed').selectOption('1000');
  await eventually(async () => assert.equal(await points(), all));  // To its end.
  await page.locator('#replay-end').click();
  await page.locator('.replay-badge').becomesHidden();
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
