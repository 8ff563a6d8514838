// Activities at the bench and with the queue in German: no English text that is not marked as English.
import assert from 'node:assert/strict';
import {abcal, barriers, begin, complainsOfNothing, confirmDialog, eventually, inGerman, look, noEnglish, served} from './page_test.mjs';

const step = begin({pace: 10, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run'), enter: async () => {
  await inGerman();
  await served.page.locator('#take-control').click();
}});

// No text is marked as English, i.e. every text of the program has a translation.
const nothingLeftInEnglish = (where) => eventually(async () => assert.deepEqual(
  await served.page.evaluate((within) => [...document.querySelectorAll(`${within} [lang=en]`)].map((each) => each.textContent), where), []));

step('the bench is German, and what is asked before it is levelled', async (page) => {
  await served.goTo('bench');
  await page.locator('#bench-level:enabled').click();
  await page.locator('#confirm-title', {hasText: 'Drehtisch nivellieren?'}).waitFor();
  await noEnglish();
  await page.locator('#confirm-no').click();
  await page.locator('#bench-probe:enabled').click();
  await confirmDialog();
  await page.locator('#ports', {hasNotText: 'Noch nicht abgefragt.'}).waitFor();
  await noEnglish();
});

step('the queue is German until an item is mounted and checked', async (page) => {
  await served.goTo('queue');
  await page.locator('#queue-add:enabled').click();
  await page.locator('#start-runs').fill('2');
  await page.locator('#confirm-yes:enabled').waitFor();
  await noEnglish();
  await nothingLeftInEnglish('#confirm');
  await confirmDialog();
  await page.locator('#queue-list', {hasText: 'SN 0417'}).waitFor();
  await page.locator('#queue-pause:enabled').click();
  await page.locator('.queue-check:enabled').click();
  await page.locator('.queue-start:enabled').click();
  await page.locator('#confirm-title', {hasText: 'SN 0417'}).waitFor();
  await noEnglish();
  assert.deepEqual(await barriers(), []);
  await page.locator('#confirm-no').click();
  await look('queue-german');
});

step('the log is German too, and why something is refused', async (page) => {
  await served.goTo('live');
  await page.locator('#log', {hasText: 'Der Prüfling ist geprüft'}).waitFor();
  await page.locator('#log', {hasText: 'Anschlüsse sind abgefragt'}).waitFor();
  await nothingLeftInEnglish('#log');
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
