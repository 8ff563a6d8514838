// A day's work on the page alone: check, queue, scanner, mounting, runs, result, approval by a second person, certificate.
// ABCAL_DAY=emulated: with emulated instruments on pseudo-terminals, in real time; else simulated ones, much faster.
import assert from 'node:assert/strict';
import {readFileSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {barriers, begin, confirmDialog, look, noEnglish, says, served, stateIs, text} from './page_test.mjs';
import {logIn, makeRegister, PASSWORD} from './training_register.mjs';

const examples = path.join(path.dirname(fileURLToPath(import.meta.url)), '../../../docs/examples');
const emulated = process.env.ABCAL_DAY === 'emulated';
const simulated = readFileSync(path.join(examples, 'simulated.toml'), 'utf8').replace('[operator]\nname = "Operator N. N."\n', '')
  .replace('steps = 72\nstep_deg = 5.0', 'steps = 12\nstep_deg = 30.0').replace('dwell_readings = 1000', 'dwell_readings = 50');
// On terminals the instrument is the same whatever the queue names, so one that reports no identity.
const onTerminals = simulated.replace('driver = "microstrain_mip"', 'driver = "text_line"').replace('port = "simulated"', 'port = "links/stage"').replace('port = "simulated"', 'port = "links/accelerometer"')
  .replace('settle_s = 5.0', 'settle_s = 0.5').replaceAll('speed_deg_per_s = 20.0', 'speed_deg_per_s = 60.0');
const bench = emulated ? onTerminals : simulated, pace = emulated ? null : 500, paceWords = pace ? ['--pace', String(pace)] : [];

const step = begin({pace, bench, serve: ['--laboratory', path.join(examples, 'laboratory.toml')], enter: () => {}, prepare: async () => {
  if (emulated) await served.emulate();
  const lab = makeRegister(served);
  lab('add', 'item', '--maker', 'MicroStrain', '--model', '3DM-GV7-AR', '--serial-number', 'SN 0500');
}});

step('checks the bench without motion, and levels it', async (page) => {
  await logIn(page, 'Operator N. N.');
  await served.entered();
  await page.locator('#take-control').click();
  await served.goTo('bench');
  await page.locator('#bench-check:enabled').click();
  await page.locator('#checks').says(/Grade/);
  await page.locator('#bench-level:enabled').click();
  await confirmDialog();
  await page.locator('#levelling', {hasText: 'tilt of the Z axis'}).waitFor();
  await stateIs(/^The levelling is complete/);
  await says('#levelling', /level_file = "bench-.*\.level\.json"/);
  await page.locator('#bench-probe:enabled').click();
  await confirmDialog();
  await page.locator('#ports', {hasNotText: 'Not asked yet.'}).waitFor();
  await look('bench');
});

step('fills the queue by a scanner, and reorders it', async (page) => {
  await served.goTo('queue');
  for (const serial of ['<b>SN 0501</b>', 'SN 0500']) {
    await page.locator('#queue-add:enabled').click();
    await page.locator('#confirm-yes:enabled').waitFor();
    await page.keyboard.type(serial);
    await page.keyboard.press('Enter');
    await page.waitForFunction((typed) => !document.getElementById('confirm-yes').disabled && document.getElementById('start-serial-number').value === typed, serial);
    await page.locator('#start-customer-number').fill('INV-7');
    await confirmDialog();
    await page.locator('#queue-list', {hasText: serial}).waitFor();
  }
  assert.equal(await page.locator('#queue-list b').count(), 0, 'a serial number is text');
  await page.locator('[aria-label^="Up: SN 0500"]').click();
  await page.locator('#queue-list tbody tr:first-child', {hasText: 'SN 0500'}).waitFor();
  await page.waitForFunction(() => /^Up: SN 0500/.test(document.activeElement.getAttribute('aria-label')));  // The button keeps the focus.
  assert.ok(await page.locator('#queue-next').isHidden(), 'paused at first');
  await page.getByRole('button', {name: 'Let the queue go on'}).click();
  await page.locator('#queue-next', {hasText: 'Mount SN 0500'}).waitFor();
});

step('starts only the item that was checked, and asks for the next one', async (page) => {
  assert.equal(await page.locator('.queue-start').count(), 0);
  await page.locator('.queue-check:enabled').click();
  await page.locator('.queue-start:enabled').click();
  await says('#confirm-title', /Start SN 0500/);
  await confirmDialog();
  await page.waitForFunction(() => location.hash === '#live');
  await page.locator('#queue-asks', {hasText: 'SN 0501'}).waitFor();
  await stateIs(/^The run is complete/);
  await says('#item', 'SN 0500');
});

step('issues the certificate, which a second person approves with a password', async (page) => {
  await served.goTo('queue');
  await page.locator('#queue-list a').first().click();
  await page.locator('#approve-form').waitFor();
  await says('#verdict', emulated ? /Usable/ : /SIMULATED/);
  assert.equal(await page.locator('#approve-name').inputValue(), '', 'who measured is not proposed');
  const approve = async (name, password) => {
    await page.locator('#approve-name').fill(name);
    await page.locator('#approve-password').fill(password);
    await page.locator('#approve-seen').check();
    await page.locator('#approve-form button.go:enabled').click();
  };
  await approve('Operator N. N.', PASSWORD);
  await page.getByText('Operator N. N. may not approve').waitFor();
  await approve('Admin N. N.', 'another horse 7');
  await page.getByText('Name or password is not right.').waitFor();
  // If an answer is lost, it is unknown whether the request was carried out.
  await page.evaluate(() => {
    const ask = globalThis.fetch;
    globalThis.fetch = async (path) => { globalThis.fetch = ask; throw new TypeError(`no answer to ${path}`); };
  });
  await approve('Admin N. N.', PASSWORD);
  await page.getByText(/^no answer came: nobody knows whether it was carried out/).waitFor();
  await approve('Admin N. N.', PASSWORD);
  await page.locator('#certificate', {hasText: 'approved by Admin N. N.'}).waitFor();
  await page.locator('#certified', {hasText: /s_ux.*\/\(m\/s²\)/s}).waitFor();
  const number = (await text('#certificate')).match(/T-\d{4}-\d{4}/)[0];
  console.log(`certificate ${number}`);
  const xml = readFileSync(await served.download(() => page.getByRole('link', {name: 'Certificate (DCC XML)'}).click()), 'utf8');
  for (const words of [number, 'INV-7', 'SN 0500']) assert.ok(xml.includes(words), words);
  await look('certificate');
  await page.locator('#language').click();
  await page.locator('#certificate', {hasText: 'freigegeben von Admin N. N.'}).waitFor();
  await page.locator('#certificate summary').click();
  await page.locator('#approve-reason').waitFor();
  await noEnglish();
  assert.deepEqual(await barriers(), []);
  await page.locator('#language').click();
  await page.locator('#certificate', {hasText: 'approved by Admin N. N.'}).waitFor();
});

step('a restarted server has the queue, paused', async (page) => {
  const ended = new Promise((resolve) => served.server.on('exit', resolve));
  served.server.kill('SIGINT');
  await ended;
  served.problems.length = 0;  // Drops the lost connection, which the page reported.
  await served.serveAgain(...paceWords);
  await served.goTo('queue');
  await page.locator('#queue-state', {hasText: 'paused'}).waitFor();
  await page.locator('#queue-list', {hasText: '<b>SN 0501</b>'}).waitFor();
  assert.ok(await page.locator('#queue-next').isHidden());
});
