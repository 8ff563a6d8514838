// Approval by key on the page: the certificate is downloaded, signed where the key is, and handed in.
import assert from 'node:assert/strict';
import {readFileSync, writeFileSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {barriers, begin, eventually, look, noEnglish, says, served} from './page_test.mjs';
import {logIn, makeRegister} from './training_register.mjs';

const examples = path.join(path.dirname(fileURLToPath(import.meta.url)), '../../../docs/examples'), laboratory = path.join(examples, 'laboratory.toml');
const bench = readFileSync(path.join(examples, 'simulated.toml'), 'utf8').replace('[operator]\nname = "Operator N. N."\n', '')
  .replace('steps = 72\nstep_deg = 5.0', 'steps = 12\nstep_deg = 30.0').replace('dwell_readings = 1000', 'dwell_readings = 50');
const inFolder = (name) => path.join(served.folder, name);

const step = begin({pace: 100, serve: ['--laboratory', laboratory], enter: () => {}, bench, prepare: () => {
  const lab = makeRegister(served);
  for (const [name, file] of [['Admin N. N.', 'admin'], ['Operator N. N.', 'operator']])
    lab('key', name, '--kind', 'person', '-o', inFolder(`${file}.pem`), '--certificate', inFolder(`${file}.crt`));
  lab('login', 'Operator N. N.', '--password-file', inFolder('password'));
  served.abcal('run', 'bench.toml', '-o', 'first.run');
}});

const sign = (xml, key, to) => served.abcal('lab', 'sign', xml, '--sign', inFolder(`${key}.pem`), '--certificate', inFolder(`${key}.crt`), '-o', inFolder(to), '--force');

async function prepare(page) {
  await page.locator('#approve-by-key summary').click();
  await page.locator('#key-seen').check();
  await page.locator('#key-form button:enabled').click();
  await page.locator('#hand-in-form').waitFor();
}

async function handIn(page, file, words) {
  await page.locator('#key-file').choose(inFolder(file));
  await page.locator('#hand-in-form button.go:enabled').click();
  await says('#key-said', words);
}

step('shows the keys of who is logged in, and makes what is to be signed', async (page) => {
  await logIn(page, 'Admin N. N.');
  await served.entered();
  served.problems.length = 0;  // Drops those of the login page.
  await page.goto(`${served.address}#runs/first.run`);
  await prepare(page);
  assert.equal(await page.locator('#approve-by-key code').first().innerText().then((words) => words.length), 64);
  await says('#key-said', /^T-\d{4}-0001 waits for your signature\.$/);
  assert.deepEqual(await barriers(), []);
  await look('by-key');
});

step('refuses another signature, and takes that of the approver', async (page) => {
  const xml = await served.download(() => page.locator('#key-download').click());
  writeFileSync(inFolder('unsigned.xml'), readFileSync(xml));
  await handIn(page, 'unsigned.xml', /no signature with an X\.509 certificate/);
  sign(xml, 'operator', 'operator.xml');
  await handIn(page, 'operator.xml', /none of Admin N\. N\.'s in the register/);
  sign(xml, 'admin', 'signed.xml');
  served.problems.length = 0;  // Drops the refusals, which the browser reports.
  await page.locator('#key-file').choose(inFolder('signed.xml'));
  await page.locator('#hand-in-form button.go:enabled').click();
  await page.locator('#certificate', {hasText: 'approved by Admin N. N.'}).waitFor();
  const issued = await served.download(() => page.getByRole('link', {name: 'Certificate (DCC XML)'}).click());
  assert.equal(readFileSync(issued, 'utf8'), readFileSync(inFolder('signed.xml'), 'utf8'));
  assert.match(served.abcal('verify', 'first.run'), /verifies by a key of Admin N\. N\./);
});

step('says so in German too', async (page) => {
  await page.locator('#language').click();
  await page.locator('#certificate', {hasText: 'freigegeben von Admin N. N.'}).waitFor();
  await page.locator('#certificate summary').first().click();
  await page.locator('#approve-by-key summary').click();
  await page.locator('#key-reason').fill('Kundenname');
  await page.locator('#key-amendment').selectOption('administrative');
  await page.locator('#key-seen').check();
  await page.locator('#key-form button:enabled').click();
  await page.locator('#hand-in-form').waitFor();
  await noEnglish();
  await handIn(page, 'unsigned.xml', /nicht der Kalibrierschein, der zu signieren war/);
  await eventually(async () => assert.equal(await page.locator('#key-said [lang=en]').count(), 0));
  await noEnglish();
  served.problems.length = 0;  // Drops the refusal.
});
