// The page makes no false statement on requests, control, the time left, halted axes, and runs that went on or ended.
import assert from 'node:assert/strict';
import {begin, confirmDialog, ENDLESS, says, served, stateIs} from './page_test.mjs';

const PACE = 3;
const step = begin({pace: PACE, bench: ENDLESS});
const contact = () => served.page.waitForFunction(() => document.getElementById('link').textContent === 'Connected');

// Runs in the page, before its scripts: lets the test send messages as the console does, and prevents a new connection while the
// page is `away`.
function tap() {
  globalThis.WebSocket = class extends WebSocket {
    constructor(address) {
      if (globalThis.away) return globalThis.line = {readyState: 0};
      super(address);
      globalThis.line = this;
      this.addEventListener('message', ({data}) => {
        const message = JSON.parse(data);
        if (message.type === 'snapshot') globalThis.snapshot = message;
      });
    }
  };
}
const tell = (message) => served.page.evaluate((told) => globalThis.line.onmessage({data: JSON.stringify(told)}), message);
const activity = (name, more = {}) => tell({type: 'activity', activity: name, hold_asked: false, stop_asked: false, ...more});

step('what takes time was accepted; what is done with the answer is done', async (page) => {
  await page.page.evaluateOnNewDocument(tap);
  await page.reload();
  await contact();
  await page.locator('#take-control').click();
  await says('#reply', 'Control: done');
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await says('#reply', 'Start: accepted');
  await served.measuredAtLeast(2);
  await page.locator('#do-hold:enabled').click();
  await says('#reply', 'Hold: accepted');
  await stateIs(/^Held/);
});

step('the time left does not run while a port is waited for, and ends in no "0 s" that lasts', async (page) => {
  await says('#left', / s \(held\)$/);
  const limit = {limit_s: null, limit_words: null, limit_simulated: false};
  await tell({type: 'phase', position: 4, phase: 'waiting for a port to come back', ...limit});
  await says('#left', / s \(waiting for a port\)$/);
  const snapshot = await page.evaluate(() => globalThis.snapshot);
  snapshot.activity = {activity: 'running', hold_asked: false, stop_asked: false};
  snapshot.phase = {position: 4, phase: 'settling', ...limit};
  snapshot.run.progress.left_s = 0.5;
  await tell(snapshot);
  await says('#left', 'longer than predicted');
});

step('a page that has control again says nothing else', async (page) => {
  await page.evaluate(() => globalThis.line.close());
  await says('#lost-control', /^This page no longer has control: this page lost its connection/);
  await contact();
  await says('#left', / s \(held\)$/);
  await says('#reply', '');
  await page.locator('#take-control:enabled').click();
  await page.locator('#do-continue:enabled').waitFor();
  await says('#lost-control', '');
});

step('without contact the time left is the last that was known', async (page) => {
  // After the end of a run no time is left.
  await page.evaluate(() => {
    globalThis.away = true;
    globalThis.line.onmessage({data: JSON.stringify({type: 'activity', activity: 'idle', hold_asked: false, stop_asked: false})});
    globalThis.line.close();
  });
  await page.waitForFunction(() => globalThis.line.readyState === 0);
  await says('#left', '–');
  await page.evaluate(() => { globalThis.away = false; globalThis.line.onclose(); });
  await contact();
  await says('#left', / s \(held\)$/);
  served.server.kill('SIGSTOP');
  await says('#left', / s \(held\), last known$/);
  served.server.kill('SIGCONT');
  await contact();
  await says('#left', / s \(held\)$/);
});

step('nothing has halted before the axes have said so, nor after somebody has moved them', async (page) => {
  await activity('running', {stop_asked: true});
  await says('#state', 'Stopping: the stage is being halted');
  await page.locator('#do-stop:enabled').click();
  await stateIs(/^The run is interrupted/);
  await says('#halt', /^Axis X has halted\. Axis Z has halted\./);
  await page.evaluate(() => { globalThis.away = true; globalThis.line.close(); });
  await page.waitForFunction(() => globalThis.line.readyState === 0);
  const other = await served.newPage();
  await other.goto(served.address);
  await other.getByRole('button', {name: 'Take control'}).click();
  await other.locator('#resume-interrupted:enabled').click();
  await other.locator('#confirm-yes').click();
  await other.locator('#banner-word', {hasText: /^(Homing|Measuring)$/}).waitFor();
  await page.front();
  await says('#halt', /^Axis X has halted/);
  await page.evaluate(() => { globalThis.away = false; globalThis.line.onclose(); });
  await contact();
  await says('#halt', '');
  await other.close();
});

step('the list of runs does not go on to say that a run is in progress', async (page) => {
  await served.goTo('runs');
  await says('#run-table', /running, or its program died/);
  await page.locator('#do-stop:enabled').click();
  await says('#run-table', /SIMULATED interrupted/);
});

step('nor does the page of that run', async (page) => {
  await served.goTo('live');
  await page.locator('#take-control:enabled').click();
  await served.goTo('runs');
  await page.locator('button.resume:enabled').click();
  await confirmDialog();
  await says('#banner-word', /^(Homing|Measuring)$/);
  await served.goTo('runs');
  await page.locator('#run-table th a').click();
  await says('#verdict', /The run is running, or its program died/);
  await page.locator('#do-stop:enabled').click();
  await says('#verdict', /The run is interrupted/);
});

step('the angles of a run are not those of a turn by hand', async (page) => {
  await activity('jogging');
  await page.waitForFunction(() => /^Moving – /.test(document.title));
  await activity('idle');
});

step('without a console: says so in its own words, and is not left for a page of the browser', async (page) => {
  const holder = served.holder(), ended = new Promise((resolve) => served.server.on('exit', resolve));
  served.server.kill('SIGKILL');
  process.kill(holder, 'SIGKILL');
  await ended;
  await served.goTo('chart');
  await says('#chart-body', 'There is no connection to the console');
  await page.locator('#language').click();
  await says('#reply', 'Language: not changed, there is no connection to the console');
  await served.goTo('runs');
  await says('#run-table', 'There is no connection to the console');
});

step('a bench that has begun anew has no run, and the page shows none', async () => {
  await served.serveAgain('--pace', String(PACE));
  await contact();
  await says('#run-table', /\.run/);
  await served.goTo('live');
  for (const id of ['measured', 'left', 'run-file', 'operator', 'time']) await says(`#${id}`, '–');
  await says('#item', 'SN 0417');  // The one that is loaded.
  assert.equal(await served.text('#simulated'), '');
});
