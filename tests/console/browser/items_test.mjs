// Several items: the start form, a card for each while the run goes on, and the result of each.
import assert from 'node:assert/strict';
import path from 'node:path';
import {abcal, barriers, begin, complainsOfNothing, confirmDialog, eventually, look, noEnglish, says, served, stateIs} from './page_test.mjs';
import {tray} from './tray.mjs';

const step = begin({pace: 30, bench: tray, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});

step('the start form names the items, and asks what is to be done with those that are not there', async (page) => {
  await page.locator('#take-control').click();
  await page.locator('#do-start:enabled').click();
  await page.locator('#confirm-yes:enabled').waitFor();
  await page.locator('#start-items li').countIs(3);
  await says('#start-items', /6284\.000002/);
  assert.ok(await page.locator('#start-serial-number').isHidden(), 'the bench file says which items there are');
  assert.deepEqual(await barriers(), []);
  await page.locator('#start-without-missing').check();
  await look('start-form-items');
  // On a busy machine the run would be over before this program asked it to wait.
  await served.pressAt(9, 'do-hold');
  await confirmDialog();
});

step('each item has a card while the run goes on', async (page) => {
  await page.locator('#items > li').countIs(3);
  await page.locator('#items > li', {hasText: /Item 3: 6284\.000003.*[1-9]\d* of \d+ angles.*[+−]\d\.\d{6}/}).waitFor();
  await look('items-live');
});

// The readings that the console reports.
const told = (page) => page.evaluate(() => new Promise((resolve) => {
  const socket = new WebSocket(`ws://${location.host}/live`);
  socket.onmessage = ({data}) => {
    const message = JSON.parse(data);
    if (message.type === 'snapshot') { socket.close(); resolve(message.strip); }
  };
}));
const drawn = (page) => page.evaluate(() => { const [xs, ...columns] = document.getElementById('strip').chart.values; return columns.map((ys) => ys.map((y, i) => [xs[i], y])); });

step('the readings of one item are drawn, of the one that is chosen', async (page) => {
  await page.locator('#strip-item option').countIs(3);
  await says('#strip-of', ': Item 1');
  await says('#strip-table', /[+−]\d\.\d{6} g/);
  await says('#temperature', /^2\d\.\d\d °C \(Item 1\)$/);
  await page.locator('#items > li[data-item="2"]', {hasText: /Temperature 2\d\.\d\d °C/}).waitFor();
  await stateIs(/^Held/);
  for (const k of [3, 1, 2]) {
    await page.locator('#strip-item').selectOption(String(k));
    await says('#strip-of', `: Item ${k}`);
    await eventually(async () => {
      const groups = (await told(page)).filter(({item}) => item === k);
      assert.ok(groups.length >= 2, String(groups.length));
      assert.deepEqual(await drawn(page), [0, 1, 2].map((j) => groups.map(({time_s: x, mean}) => [x, mean[j]])));
    });
  }
  await page.goto(`${served.address}#kiosk`);
  await page.locator('#strip-choice').becomesHidden();  // Stop is the only control.
  assert.ok(await page.locator('#strip-of').isVisible());
  await look('items-kiosk');
  await page.goto(`${served.address}#live`);
  await page.locator('#do-continue:enabled').click();
  await confirmDialog();
});

step('all angles of each item are counted', async (page) => {
  await stateIs(/^The run is complete/);
  await eventually(async () => {
    for (const words of await page.locator('#items > li').allInnerTexts()) assert.match(words, /\b(\d+) of \1 angles/);
  });
  assert.deepEqual(await barriers(), []);
});

step('each item has a result of its own, and downloads', async (page) => {
  await page.goto(`${served.address}#runs/first.run`);
  await says('#run-item', 'Result of item 1');
  await page.locator('#result-items a', {hasText: 'Result of item 3'}).click();
  await says('#run-item', 'Result of item 3');
  await page.locator('#result-items [data-item="3"] a[aria-current]').waitFor();
  await page.waitForFunction(() => document.activeElement?.id === 'main');
  const printed = JSON.parse(abcal('analyse', 'first.run', '--item', '3', '--estimator', 'abc', '--json'));
  const shown = await page.locator('#estimators tbody tr', {hasText: /^O_u/}).evaluateAll((rows) => [...rows[0].children].map((cell) => cell.textContent));
  const value = Number(shown[4].replace('−', '-')), digits = (shown[4].split('.')[1] ?? '').length;
  assert.ok(Math.abs(value - printed.offset[0].value) <= 0.5001 * 10 ** -digits, `${shown} for ${printed.offset[0].value}`);
  const csv = await served.download(() => page.getByRole('link', {name: 'Averaged readings (CSV)'}).click());
  assert.match(path.basename(csv), /^first-item-3-readings/);
  assert.deepEqual(await barriers(), []);
  await look('items-result');
  await page.locator('#language').click();
  await says('#run-item', 'Ergebnis von Gegenstand 3');
  await noEnglish();
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
