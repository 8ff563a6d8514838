// One of several items falls silent in the middle of a run; another is not there when the run is resumed.
import assert from 'node:assert/strict';
import {barriers, begin, complainsOfNothing, confirmDialog, eventually, look, noEnglish, says, served, stateIs, text} from './page_test.mjs';
import {emulatedTray, LINKS} from './tray.mjs';

let control;  // Sends a request to the emulator.
const step = begin({bench: emulatedTray, prepare: async () => { control = await served.emulate(LINKS); }});
const card = (page, k) => page.locator(`#items > li[data-item="${k}"]`);
const measuredOf = async (page, k) => Number((await card(page, k).innerText()).match(/(\d+) of \d+ angles/)[1]);

step('an item that falls silent is named on its card, and the run of the others goes on', async (page) => {
  await page.locator('#take-control').click();
  await served.press('#do-start');
  await page.locator('#items > li').countIs(3);
  await served.measuredAtLeast(2);
  const banner = await served.recorded('banner-word'), phases = await served.recorded('phase');
  await control({do: 'fault', kind: 'no-output', instrument: 'item-3'});
  await page.locator('#items > li.left-out[data-item="3"]', {hasText: /left out: item 3, accelerometer .*no reading for 2 s/}).waitFor();
  const left = await measuredOf(page, 3);
  await served.measuredAtLeast(left + 3);
  assert.equal(await measuredOf(page, 3), left);
  await eventually(async () => assert.ok(await measuredOf(page, 1) > left && await measuredOf(page, 2) > left));
  await page.locator('#items > li.left-out').countIs(1);
  assert.equal(await text('#banner-word'), 'Measuring');
  assert.deepEqual(await banner(), [], 'the banner is steady');
  assert.ok(new Set(await phases()).size > 1, 'and the phases follow each other');
  await page.locator('#strip-item').selectOption('2');
  await says('#strip-table', /[+−]\d\.\d{6} g/);
  assert.deepEqual(await barriers(), []);
  await look('items-left-out');
});

step('a run is resumed without the items that are not there if a person says so', async (page) => {
  await page.locator('#do-stop').click();
  await stateIs(/^The run is interrupted/);
  await control({do: 'fault', kind: 'silence', instrument: 'item-2'});
  const measured = await served.measured();
  await page.locator('#resume-interrupted:enabled').click();
  await says('#confirm-more', /^2 items take part\. One that is left out stays left out\./);
  assert.deepEqual(await barriers(), []);
  await confirmDialog();
  await page.locator('#log-lines', {hasText: /1 of 2 are not there/}).waitFor();
  await page.locator('#banner-word', {hasText: 'Faulted'}).waitFor();

  // The run was not resumed, and still can be.
  await page.locator('#resume-interrupted:enabled').click();
  await page.locator('#resume-without-missing').check();
  await confirmDialog();
  await served.measuredAtLeast(measured + 1);
  await card(page, 2).locator('.grade-warning', {hasText: 'item 2 takes no part'}).waitFor();
  await card(page, 3).locator('.grade-warning', {hasText: 'no reading for 2 s'}).waitFor();
  await eventually(async () => assert.ok(await measuredOf(page, 2) < await measuredOf(page, 1)));
  await says('#response-of', ': Item 1');
  await says('#strip-of', ': Item 2');  // The chosen item stays.
});

step('says so in German too', async (page) => {
  await page.locator('#language').click();
  await card(page, 3).locator('.grade-warning', {hasText: 'Gegenstand 3, Aufnehmer'}).waitFor();
  await page.locator('#do-stop:enabled').click();
  await stateIs(/^Der Lauf ist unterbrochen/);
  await page.locator('#take-control').click();
  await page.locator('#resume-interrupted:enabled').click();
  await page.locator('#confirm-yes:enabled').waitFor();
  await noEnglish();
  await page.locator('#confirm-no').click();
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
