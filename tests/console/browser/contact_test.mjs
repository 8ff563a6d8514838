// The statements of the page without contact: console stopped, killed, restarted; the process that holds the bench killed. Also
// how anybody stops the bench.
import assert from 'node:assert/strict';
import {begin, confirmDialog, ENDLESS, eventually, measured, says, served, stateIs, text} from './page_test.mjs';

const PACE = 3;
const step = begin({pace: PACE, bench: ENDLESS});
const wordIs = (pattern) => served.page.waitForFunction((source) => new RegExp(source).test(document.getElementById('banner-word').textContent), pattern.source);
const contact = () => served.page.waitForFunction(() => document.getElementById('link').textContent === 'Connected');
const iconIs = (name) => served.page.waitForFunction((expected) => document.getElementById('favicon').getAttribute('href') === expected, `/favicon-${name}.svg`);
let runName;

step('says what the bench does, in a word, with its limit, in the title and in the icon of the tab', async (page) => {
  await wordIs(/^Idle$/);
  await page.locator('#do-stop').becomesDisabled();  // Nothing can move.
  await page.locator('#take-control').click();
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await wordIs(/^Measuring$/);
  await page.waitForFunction(() => /^\d+ (s|min)/.test(document.getElementById('limit').textContent));
  await page.waitForFunction(() => /^Measuring, \d+ of 119 – bench\.toml$/.test(document.title));
  await iconIs('busy');
  await says('#reply', 'Start: accepted');
  await says('#run-file', /\.run$/);
  runName = await text('#run-file');
});

step('with the console stopped: nothing counts on, all is stamped, and a stop says that it is not confirmed', async (page) => {
  await served.measuredAtLeast(3);
  served.server.kill('SIGSTOP');
  await page.waitForFunction(() => /^No contact for \d+ s, last known at \d\d:\d\d:\d\d UTC/.test(document.getElementById('contact').textContent));
  await wordIs(/^No contact$/);
  await iconIs('lost');
  await page.waitForFunction(() => /^No contact/.test(document.title) && document.body.classList.contains('no-contact'));
  const left = await text('#left'), since = await text('#contact');
  await page.waitForFunction((before) => document.getElementById('contact').textContent !== before, since);
  assert.equal(await text('#left'), left, 'the time left is not counted down');
  await page.locator('#do-hold').becomesDisabled();
  const halt = await served.recorded('halt');
  await page.locator('#do-stop:enabled').click();
  await says('#halt', 'Stop: not confirmed after 2 s: use the switch on the stage');
  assert.equal((await halt())[0], 'Stop: sent');
  served.server.kill('SIGCONT');
  await contact();
  // The Stop was sent nevertheless.
  await stateIs(/^The run is interrupted and can be resumed/);
  await says('#halt', /^Axis X has halted\. Axis Z has halted\./);
});

step('offers to resume the run that was interrupted, and where', async (page) => {
  await says('#interrupted-words', new RegExp(`^${runName} was interrupted at (experiment \\d, [\\d.]+ degrees|check pose \\d).*: \\d+ of 119 angles are measured`));
  await page.locator('#resume-interrupted:enabled').click();
  await confirmDialog();
  await wordIs(/^(Measuring|Homing)$/);
  await page.locator('#interrupted').becomesHidden();
});

step('with the console killed: says so, and finds the run again, which went on', async (page) => {
  const before = await measured();
  await served.measuredAtLeast(before + 1);
  const ended = new Promise((resolve) => served.server.on('exit', resolve));
  served.server.kill('SIGKILL');
  await ended;
  await wordIs(/^No contact$/);
  await page.getByText(/^No contact for \d+ s/).waitFor();
  const known = await measured();
  await served.serveAgain('--pace', String(PACE));
  await contact();
  await wordIs(/^Measuring$/);
  await served.measuredAtLeast(known + 1);
  await page.getByText('This page no longer has control: this page lost its connection').waitFor();
  const times = await page.evaluate(() => document.getElementById('strip').chart.values[0]);
  assert.ok(times.every((t, i) => i === 0 || t >= times[i - 1]), 'the strip does not run backwards');
});

step('stops with Escape pressed twice, in a dialog and without control', async (page) => {
  await page.locator('#take-control').click();
  await page.locator('#do-hold:enabled').click();
  await stateIs(/^Held/);
  await page.locator('#do-continue:enabled').click();
  await page.locator('#dialog-stop').becomesEnabled();
  assert.equal(await page.evaluate(() => document.querySelector('#confirm button').id), 'dialog-stop', 'first in the dialog');
  const watcher = await served.newPage();
  await watcher.goto(served.address);
  await watcher.locator('#do-stop:enabled').waitFor();
  await watcher.keyboard.press('Tab');
  await watcher.waitForFunction(() => document.activeElement.id === 'do-stop');  // First in the order of Tab.
  await watcher.close();
  await page.front();
  await Promise.all(['down', 'up', 'down', 'up'].map((does) => page.keyboard[does]('Escape')));  // Within a second, however slow this machine is.
  await wordIs(/^Interrupted$/);
  await says('#halt', /^Axis X has halted\. Axis Z has halted\. \(\d\.\d\d s, \d\d:\d\d:\d\d UTC\)$/);
});

step('shows times of one kind, UTC or local', async (page) => {
  const zones = () => page.evaluate(() => [...document.querySelectorAll('time')].map((time) => time.textContent.split(' ').at(-1)));
  const all = async (kind) => { const shown = await zones(); assert.ok(shown.length > 0 && shown.every((zone) => zone === kind), shown.join(' ')); };
  await eventually(() => all('UTC'));
  await page.locator('#times').click();
  await eventually(() => all('local'));
  await page.locator('#times').click();
});

step('with the process that holds the bench killed: says so, and offers the run again', async (page) => {
  await page.locator('#resume-interrupted:enabled').click();
  await confirmDialog();
  await wordIs(/^Measuring$/);
  process.kill(served.holder(), 'SIGKILL');
  await page.locator('#interrupted').waitFor();
  await says('#interrupted-words', /Its program died/);
  await wordIs(/^Idle$/);
});

step('is a display on a wall', async (page) => {
  await page.locator('nav a[href="#kiosk"]').click();
  await page.locator('#steering').becomesHidden();
  await page.locator('#do-stop').waitFor();
  const height = await page.evaluate(() => parseFloat(getComputedStyle(document.getElementById('banner-word')).fontSize));
  assert.ok(height >= 80, `${height} px`);
  await page.locator('#interrupted').waitFor();
  assert.deepEqual(await page.evaluate(() => [...document.querySelectorAll('button')].filter((button) => button.checkVisibility()).map(({id}) => id)), ['do-stop']);
  await page.locator('#leave-kiosk').click();
  await page.locator('#steering').waitFor();
});
