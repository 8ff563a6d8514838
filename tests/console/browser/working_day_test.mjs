// A day with two items: the stage stalls during the run of the first one, a person acknowledges it and resumes the run, and a
// certificate is issued; an output of the second one is stuck for a while, so that its result is doubtful. Printed are the time to the
// first datum, its place on the screen, and the number of clicks from the flag of the stuck output to its readings.
import assert from 'node:assert/strict';
import {readFileSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {begin, clicksToReadings, confirmDialog, contrastPictures, firstDatum, look, says, served, stateIs, text} from './page_test.mjs';
import {logIn, makeRegister, PASSWORD} from './training_register.mjs';

const examples = path.join(path.dirname(fileURLToPath(import.meta.url)), '../../../docs/examples');
const sound = readFileSync(path.join(examples, 'simulated.toml'), 'utf8').replace('[operator]\nname = "Operator N. N."\n', '')
  .replace('steps = 72\nstep_deg = 5.0', 'steps = 12\nstep_deg = 30.0').replace('dwell_readings = 1000', 'dwell_readings = 50');
const stalled = `${sound}\n[[fault]]\nkind = "stalled-axis"\naxis = "z"\nat_s = 340.0\n`;
const stuck = `${sound}\n[[fault]]\nkind = "stuck-output"\noutput = "v"\nat_s = 200.0\nfor_s = 60.0\n`;
const SERIALS = ['SN 0500', 'SN 0501'];
const step = begin({pace: 100, bench: stalled, serve: ['--laboratory', path.join(examples, 'laboratory.toml')], enter: () => {}, prepare: () => {
  const lab = makeRegister(served);
  for (const serial of SERIALS) lab('add', 'item', '--maker', 'MicroStrain', '--model', '3DM-GV7-AR', '--serial-number', serial);
}});

step('shows the first datum soon, and in the first quarter of the screen', async (page) => {
  await logIn(page, 'Operator N. N.');
  await served.entered();
  await page.reload();
  const after = await page.evaluate(() => new Promise((resolve) => {
    const look = () => (document.querySelector('#ready-facts dd')?.checkVisibility() ? resolve(performance.now()) : setTimeout(look, 5));
    look();
  }));
  const first = await firstDatum(page);
  console.log(`first datum after ${Math.round(after)} ms, at ${Math.round(100 * first.at)} % of the height`);
  assert.ok(first.at <= 0.25, JSON.stringify(first));
});

step('fills the queue with both items, and starts the first one', async (page) => {
  await page.locator('#take-control').click();
  await served.goTo('queue');
  for (const serial of SERIALS) {
    await page.locator('#queue-add:enabled').click();
    await page.locator('#confirm-yes:enabled').waitFor();
    await page.keyboard.type(serial);
    await page.keyboard.press('Enter');
    await page.waitForFunction((typed) => !document.getElementById('confirm-yes').disabled && document.getElementById('start-serial-number').value === typed, serial);
    await confirmDialog();
    await page.locator('#queue-list', {hasText: serial}).waitFor();
  }
  await page.getByRole('button', {name: 'Let the queue go on'}).click();
  await page.locator('.queue-check:enabled').click();
  await page.locator('.queue-start:enabled').click();
  await confirmDialog();
});

step('the stage stalls: the page says so, a person acknowledges it and resumes the run', async (page) => {
  await page.locator('#banner-word').says('Faulted');
  await says('#state', /The run is interrupted and can be resumed: .*stalled/);
  await look('fault');
  await contrastPictures('fault');
  await page.locator('#acknowledged').says('Nobody has acknowledged it yet.');
  await page.locator('#acknowledge:enabled').click();
  await page.locator('#acknowledged').says(/^Acknowledged by Operator N\. N\., register .*, \d\d:\d\d/);
  served.describe(sound);
  await page.locator('#resume-interrupted:enabled').click();
  await confirmDialog();
  await says('#state', /^The run is complete/);
  await served.goTo('runs');
  await page.locator('#run-table tbody a').first().click();
  await says('#answer', /interrupted and resumed once/);
  await page.getByText('alarm acknowledged').waitFor();
});

step('issues the certificate of the first item, which a second person approves', async (page) => {
  await page.locator('#approve-name').fill('Admin N. N.');
  await page.locator('#approve-password').fill(PASSWORD);
  await page.locator('#approve-seen').check();
  await page.locator('#approve-form button.go:enabled').click();
  await page.locator('#certificate', {hasText: 'approved by Admin N. N.'}).waitFor();
  assert.match(await text('#certificate'), /T-\d{4}-\d{4}/);
});

step('the second item: a stuck output is flagged, its readings are two clicks away, and the result is doubtful', async (page) => {
  served.describe(stuck);
  await served.goTo('queue');
  await page.locator('#queue-state', {hasText: 'paused'}).waitFor();  // Since the fault.
  await page.getByRole('button', {name: 'Let the queue go on'}).click();
  await page.locator('#queue-next', {hasText: 'Mount SN 0501'}).waitFor();
  await page.locator('.queue-check:enabled').click();
  await page.locator('.queue-start:enabled').click();
  await confirmDialog();
  await page.locator('#flagged a').waitFor();
  await says('#state', /^The run is complete/);
  const clicks = await clicksToReadings('stuck output');
  console.log(`${clicks} clicks from the flag to the readings`);
  assert.equal(clicks, 2);
  await says('#verdict', /Doubtful/);
  await look('doubtful');
  await contrastPictures('result');
});

step('the life of the second item has its one run', async (page) => {
  await page.locator('a[href="#life/item/SN%200501"]').first().click();
  await page.locator('#run-life-title').says('Life of the item SN 0501');
  await says('#run-life', /\? Doubtful: 1/);
  await page.locator('#run-table tbody tr').countIs(1);
  await look('life');
});
