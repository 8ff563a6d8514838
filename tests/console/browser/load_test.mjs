// 3 x 360 angles at 60 times real time: few nodes in tables, little work in each frame, no long task. Measured by Chromium's trace
// in processor time, as the tests' machine is busy with more than this page.
import assert from 'node:assert/strict';
import {begin, BENCH, complainsOfNothing, confirmDialog, measured, served} from './page_test.mjs';

const SECONDS = 5;
const step = begin({pace: 60, bench: BENCH.replace('steps = 12\nstep_deg = 30.0', 'steps = 360\nstep_deg = 1.0')});

// Repeats the last message of an angle as a message of each other angle of the plan.
step('shows as many angles as the run has at its end', async (page) => {
  await page.page.evaluateOnNewDocument(() => {
    globalThis.WebSocket = class extends WebSocket {
      constructor(...words) {
        super(...words);
        globalThis.socket = this;
        this.addEventListener('message', ({data}) => { if (data.includes('"event":"dwell_done"')) this.told = JSON.parse(data); });
      }
    };
  });
  await page.reload();
  await page.locator('#take-control:enabled').click();
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await served.measuredAtLeast(5);
  await page.evaluate(() => {
    const {told} = globalThis.socket;
    for (let i = 40; i < 1092; ++i) {
      const experiment = 1 + Math.floor(i / 364);
      const dwell = {...told.dwell, experiment, alpha_deg: i % 364};
      globalThis.socket.onmessage({data: JSON.stringify({...told, position: i, dwell, fit: {...told.fit, experiment}})});
    }
  });
});

// The work of the page's main thread: [start, duration] of its tasks, and the starts of its frames, in ms.
async function traced(page) {
  await page.page.tracing.start({categories: ['toplevel', 'devtools.timeline']});
  await page.waitForTimeout(1000 * SECONDS);
  const {traceEvents: all} = JSON.parse(new TextDecoder().decode(await page.page.tracing.stop()));
  const frames = all.filter(({name, ph}) => name === 'FireAnimationFrame' && ph === 'X');
  const {pid, tid} = frames[0];
  const ofPage = (event) => event.pid === pid && event.tid === tid;
  const tasks = all.filter((event) => /RunTask$/.test(event.name) && event.ph === 'X' && ofPage(event)).map(({ts, tdur, dur}) => [ts / 1000, (tdur ?? dur) / 1000]);
  return {tasks, frames: frames.filter(ofPage).map(({ts}) => ts / 1000).sort((a, b) => a - b)};
}

step('works little, and never for long', async (page) => {
  const before = await measured();
  await page.locator('summary', {hasText: 'The angles as a table'}).click();
  await served.measuredAtLeast(before + 1);
  await page.waitForFunction(() => document.querySelectorAll('#dwell-table tbody tr').length > 40);
  const nodes = await page.evaluate(() => document.querySelectorAll('table, table *').length);
  assert.ok(nodes > 400 && nodes <= 2000, `${nodes} nodes in tables`);
  const {tasks, frames} = await traced(page);
  assert.ok(await measured() > before, 'the run goes on');
  // On a busy machine frames are late and handle the messages of several: the work is scaled to the time of one frame, 1/60 s.
  const work = frames.slice(1).map((end, i) => tasks.filter(([at]) => at >= frames[i] && at < end).reduce((sum, [, took]) => sum + took, 0) * Math.min(1, 1000 / 60 / (end - frames[i])));
  work.sort((a, b) => a - b);
  const median = work[Math.floor(work.length / 2)], longest = Math.max(...tasks.map(([, took]) => took));
  console.log(`${nodes} nodes in tables; ${work.length} frames: median ${median.toFixed(2)} ms, 90 % ${work[Math.floor(0.9 * work.length)].toFixed(2)} ms; longest task ${longest.toFixed(1)} ms`);
  assert.ok(work.length > 20, String(work.length));
  assert.ok(median <= 8, `${median} ms a frame`);
  assert.ok(longest <= 50, `${longest} ms in one task`);
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
