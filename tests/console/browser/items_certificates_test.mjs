// Each item of a run with several has its own certificate: by password, by key, amended.
import assert from 'node:assert/strict';
import {readFileSync} from 'node:fs';
import path from 'node:path';
import {barriers, begin, complainsOfNothing, look, noEnglish, says, served} from './page_test.mjs';
import {examples, tray} from './tray.mjs';
import {logIn, makeRegister, PASSWORD} from './training_register.mjs';

const inFolder = (name) => path.join(served.folder, name);
const step = begin({pace: 100, bench: tray.replace('[operator]\nname = "Operator N. N."\n', ''), enter: () => {},
  serve: ['--laboratory', path.join(examples, 'laboratory.toml')], prepare: () => {
    const lab = makeRegister(served);
    lab('key', 'Admin N. N.', '--kind', 'person', '-o', inFolder('admin.pem'), '--certificate', inFolder('admin.crt'));
    lab('login', 'Operator N. N.', '--password-file', inFolder('password'));
    served.abcal('run', 'bench.toml', '-o', 'first.run');
  }});

const openItem = async (page, k) => {
  await page.goto(`${served.address}#runs/first.run/${k}`);
  await says('#run-item', `Result of item ${k}`);
  await says('#certificate', /No certificate has been issued for this item\./);
};
const certificate = async (page, k) => {
  const file = await served.download(() => page.getByRole('link', {name: 'Certificate (DCC XML)'}).click());
  const xml = readFileSync(file, 'utf8');
  assert.match(xml, new RegExp(`6284\\.00000${k}`));
  return xml;
};

step('one item by the password of who approves', async (page) => {
  await logIn(page, 'Admin N. N.');
  await served.entered();
  served.problems.length = 0;  // Drops those of the login page.
  await openItem(page, 2);
  await page.locator('#approve-password').fill(PASSWORD);
  await page.locator('#approve-seen').check();
  await page.locator('#approve-form button.go:enabled').click();
  await page.locator('#certificate', {hasText: /T-\d{4}-0001, issued .* approved by Admin N\. N\./}).waitFor();
  await certificate(page, 2);
  assert.deepEqual(await barriers(), []);
  await look('items-certificate');
});

step('another item by a key, with a number of its own', async (page) => {
  await openItem(page, 3);
  await page.locator('#approve-by-key summary').click();
  await page.locator('#key-seen').check();
  await page.locator('#key-form button:enabled').click();
  await says('#key-said', /^T-\d{4}-0002 waits for your signature\.$/);
  const xml = await served.download(() => page.locator('#key-download').click());
  served.abcal('lab', 'sign', xml, '--sign', inFolder('admin.pem'), '--certificate', inFolder('admin.crt'), '-o', inFolder('signed.xml'));
  await page.locator('#key-file').choose(inFolder('signed.xml'));
  await page.locator('#hand-in-form button.go:enabled').click();
  await page.locator('#certificate', {hasText: /T-\d{4}-0002, issued .* approved by Admin N\. N\./}).waitFor();
  assert.equal(await certificate(page, 3), readFileSync(inFolder('signed.xml'), 'utf8'));
  assert.match(served.abcal('verify', 'first.run'), /verifies by a key of Admin N\. N\./);
});

step('the third has none, and says so in German too', async (page) => {
  await openItem(page, 1);
  await page.locator('#language').click();
  await says('#certificate', /^Für diesen Gegenstand wurde kein Kalibrierschein ausgestellt\./);
  await noEnglish();
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
