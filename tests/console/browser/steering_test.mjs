// Steering a bench from the page: control, check, start, hold, note.
import assert from 'node:assert/strict';
import {begin, complainsOfNothing, confirmDialog, eventually, look, measured, says, served, stateIs} from './page_test.mjs';

const step = begin({pace: 4});

step('says that its stop is no emergency stop', async (page) => {
  await says('#no-emergency', /no emergency stop/);
});

step('offers nothing before it has control', async (page) => {
  for (const id of ['do-check', 'do-start', 'do-hold', 'do-continue', 'do-stop', 'do-jog'])
    await page.locator(`#${id}`).becomesDisabled();
});

step('is used with the keyboard alone: takes control, and asks before it moves the stage', async (page) => {
  const reached = async (id) => {
    for (let i = 0; i < 40; ++i) {
      await page.keyboard.press('Tab');
      if (await page.evaluate(() => document.activeElement.id) === id) return true;
    }
    return false;
  };
  assert.ok(await reached('take-control'));
  await page.keyboard.press('Enter');
  await page.locator('#do-start:enabled').waitFor();
  assert.ok(await reached('do-start'));
  await page.keyboard.press('Enter');
  await page.locator('#confirm').waitFor();
  await page.waitForFunction(() => document.activeElement.id === 'confirm-no');
  await page.keyboard.press('Enter');
  await page.locator('#confirm').becomesHidden();
  await says('#state', 'No run is in progress.');
});

step('checks the bench', async (page) => {
  await page.locator('#do-check').click();
  await confirmDialog();
  await page.locator('#checks table').waitFor();
  await says('#checks', /signs and axes/);
  await says('#strip-table', /[+−]\d\.\d{6} g/);
  await page.locator('#do-start:enabled').waitFor();
});

step('starts a run, and points appear', async (page) => {
  const limits = await served.recorded('limit');
  await page.locator('#do-start').click();
  await confirmDialog();
  await says('#left', /^about (\d+ min )?\d+ s$/);
  await served.pressAt(8, 'do-hold');
  await served.measuredAtLeast(5);  // Two check poses come first.
  await says('#run-file', /^bench-\d{8}T\d{6}Z\.run$/);
  // Plots are drawn a moment after the number has changed.
  await page.waitForFunction(() => document.querySelector('#responses .plot').chart.values.slice(1, 4).every((ys) => ys.filter((y) => y !== null).length >= 3));
  await page.waitForFunction(() => document.getElementById('strip').chart.values.every((ys) => ys.length >= 2));
  await says('#x-encoder', /^−?\d+\.\d{4}°$/);
  await says('#strip-table', /[+−]\d\.\d{6} g/);
  await stateIs(/^Held/);
  const shown = (await limits()).filter((words) => words !== '–');
  assert.ok(shown.length > 0, 'the limits of the phases are shown');
  for (const words of shown) assert.match(words, /^(?!0 s)[\d.]+ .* of simulated time /);
});

step('shows a part of a plot, by keyboard and pointer, and no label is over another', async (page) => {
  const plots = await page.evaluate(() => [...document.querySelectorAll('#view-live .plot')].map(({chart: {plot}}) => {
    const [, y] = plot.axes, brush = plot.ctx;
    brush.save();
    brush.font = y.font[0];
    const widest = Math.max(...y._values.map((words) => brush.measureText(words).width)) / devicePixelRatio;
    brush.restore();
    return {room: y._size - widest - y.ticks.size - y.gap, legend: [...plot.root.querySelectorAll('.u-series:not([hidden]) th')].map((head) => head.textContent)};
  }));
  assert.equal(plots.length, 8);
  for (const {room} of plots) assert.ok(room >= 0, JSON.stringify(plots));
  assert.deepEqual(plots[1].legend.slice(1), ['● u', '▲ v', '■ w'], 'outputs have markers of their own');
  const range = () => page.evaluate(() => document.querySelector('#responses .plot').chart.shownX);
  const rangeIs = (expected) => eventually(async () => assert.deepEqual(await range(), expected));
  const canvas = page.locator('#responses .plot').first();
  await canvas.press('+');
  await rangeIs([90, 270]);
  await canvas.press('ArrowRight');
  await rangeIs([112.5, 292.5]);
  await canvas.press('-');
  await rangeIs([22.5, 360]);
  await canvas.press('0');
  await rangeIs([0, 360]);
  await page.evaluate(() => document.querySelector('#responses .plot').scrollIntoView({block: 'center'}));  // The pointer does not scroll.
  const box = await (await canvas.one('visible')).boundingBox();
  await page.mouse.move(box.x + box.width * 0.5, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width * 0.75, box.y + box.height / 2);
  await page.mouse.up();
  await eventually(async () => {
    const [from, to] = await range();
    assert.ok(from > 90 && to < 300 && to - from > 60 && to - from < 150, `${from} to ${to}`);
  });
  await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2, {count: 2});
  await rangeIs([0, 360]);
});

step('holds after an angle, and keeps a note', async (page) => {
  await says('#left', /^(\d+ min )?\d+ s \(held\)$/);  // Updated each second.
  const kept = await measured();
  await page.locator('#note').fill('<b>door opened</b>');
  await page.locator('#note').press('Enter');
  await page.getByText('Note, stored in the event log: <b>door opened</b>').waitFor();
  await look('live');
  assert.equal(await measured(), kept);
});

step('stops the run, and jogs an axis', async (page) => {
  await page.locator('#do-stop:enabled').click();
  await stateIs(/^The run is interrupted/);
  await page.locator('#jog-axis').selectOption('z');
  await page.locator('#jog-by').fill('-7.5');
  await page.locator('#do-jog').click();
  await confirmDialog();
  await page.getByText(/Axis Z is at -7\.50\d+ degrees/).waitFor();
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
