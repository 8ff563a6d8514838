// Logins: persons of the register log in on the page; a token is given after "#", over TLS.
import assert from 'node:assert/strict';
import {begin, confirmDialog, ENDLESS, look, says, served, stateIs} from './page_test.mjs';
import {logIn, makeRegister} from './training_register.mjs';

const cookieOf = async (page) => (await page.cookies()).find(({name}) => name.startsWith('abcal_'));

const step = begin({pace: 5, bench: ENDLESS.replace('[operator]\nname = "N. N."\n', ''), prepare: () => makeRegister(served), enter: () => {}});

step('asks for a person, and says that a password is not right', async (page) => {
  await logIn(page, 'Operator N. N.', 'another horse 7');
  await page.getByText('Name or password is not right.').waitFor();
  await look('login');
  await logIn(page, 'Operator N. N.');
  await served.entered();
  await says('#person-name', 'Operator N. N.');
  const cookie = await cookieOf(page);
  assert.equal(cookie.httpOnly, true);
  assert.equal(cookie.sameSite, 'Strict');
  assert.equal(await page.evaluate(() => document.cookie), '', 'no script can read it');
});

let watcher;
step('who may not measure watches, and stops the run of another', async (page) => {
  await page.locator('#take-control').click();
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await served.measuredAtLeast(1);
  await says('#operator', 'Operator N. N.');
  watcher = await served.newVisitor();
  await watcher.goto(served.address);
  await logIn(watcher, 'Watcher N. N.');
  await watcher.locator('#who-steers', {hasText: 'steering needs the right to measure'}).waitFor();
  await watcher.locator('#take-control').becomesDisabled();
  await watcher.locator('#who-steers').says(/^Operator N\. N\., page \d+ at .* steers\./);
  await watcher.locator('#do-stop:enabled').click();
  await stateIs(/^The run is interrupted/);
  await page.getByText(/Stop, asked for by Watcher N\. N\., page/).waitFor();
});

step('who logs out is asked again', async () => {
  await watcher.getByRole('button', {name: 'Log out'}).click();
  await watcher.locator('#password').waitFor();
  assert.equal(await cookieOf(watcher), undefined);
  await says('#person-name', 'Operator N. N.');  // Other persons stay logged in.
});

step('a token enters by "#", is never a part of an address that is sent, and its cookie stays with TLS', async () => {
  const ended = new Promise((resolve) => served.server.on('exit', resolve));
  served.server.kill('SIGINT');
  await ended;
  delete process.env.ABCAL_REGISTER;
  const address = await served.serve('--tls', '--host', 'bench.example.org', '--pace', '10');
  assert.match(address, /^https:.*#token=[0-9a-f]{64}$/);
  const token = address.split('=')[1];
  const page = await served.newVisitor();
  const sent = [];
  page.page.on('request', (request) => sent.push(request.url()));
  await page.goto(address);
  await page.waitForFunction(() => document.getElementById('link')?.textContent === 'Connected');
  assert.ok(!page.url().includes(token), page.url());
  assert.ok(sent.length > 3 && sent.every((url) => !url.split('#')[0].includes(token)), sent.join(' '));
  assert.equal((await cookieOf(page)).secure, true);
  await page.locator('#person').becomesHidden();
});
