// Pages that connect again ten times as often as people do, during one run after another: the memory of the console, of the
// process that holds the bench and of a page that is never closed stays constant. ABCAL_SOAK_MINUTES: default 3.
import assert from 'node:assert/strict';
import {readFileSync} from 'node:fs';
import {begin, confirmDialog, served} from './page_test.mjs';
import {fromRegistry} from './served_page.mjs';

const MINUTES = Number(process.env.ABCAL_SOAK_MINUTES || 3);
const EVERY_MS = 3000;  // People load a page again every half minute at most.
const OTHERS = 20;
const WebSocket = fromRegistry('ws');
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const megabytes = (pid) => Number(readFileSync(`/proc/${pid}/status`, 'utf8').match(/VmRSS:\s+(\d+)/)[1]) / 1024;
const median = (values) => [...values].sort((a, b) => a - b)[Math.floor(values.length / 2)];

const step = begin({pace: 100});

// Connects, takes the whole state, and disconnects.
async function another(number) {
  const {port} = new URL(served.address), origin = `http://127.0.0.1:${port}`;
  await new Promise((resolve) => {
    const socket = new WebSocket(`ws://127.0.0.1:${port}/live`, {origin});
    socket.on('error', resolve);
    socket.on('close', resolve);
    socket.on('message', (bytes) => {
      const {type} = JSON.parse(bytes);
      if (type === 'beat') socket.send('{"do":"beat"}');
      if (type === 'snapshot') setTimeout(() => (number % 2 ? socket.close() : socket.terminate()), Math.random() * EVERY_MS);
    });
  });
}

step(`memory is flat over ${MINUTES} min`, async (page) => {
  let on = true, connections = 0, reloads = 0, runs = 0;
  const others = Array.from({length: OTHERS}, async (_, i) => { for (; on; ++connections) await another(i); });
  const restless = await served.newPage();
  const reloading = (async () => {
    for (; on; ++reloads) {
      await restless.goto(`${served.address}?${reloads}#${['live', 'runs', 'queue', 'chart'][reloads % 4]}`);
      await pause(EVERY_MS);
    }
  })();
  await page.front();
  await page.locator('#take-control').click();
  const session = await page.page.createCDPSession();
  const seen = [], end = performance.now() + MINUTES * 60_000;
  let next = 0;
  while (performance.now() < end) {
    if (await page.evaluate(() => !document.getElementById('do-start').disabled && !document.getElementById('confirm').open)) {
      await page.locator('#do-start:enabled').click();
      await confirmDialog();
      ++runs;
    }
    if (performance.now() > next) {
      next = performance.now() + 5000;
      await session.send('HeapProfiler.collectGarbage');
      const heap = (await session.send('Runtime.getHeapUsage')).usedSize / 2 ** 20;
      seen.push({console: megabytes(served.server.pid), bench: megabytes(served.holder()), page: heap});
    }
    await pause(200);
  }
  on = false;
  await Promise.all([...others, reloading]);
  console.log(`${MINUTES} min: ${connections} connections, ${reloads} loads of a page, ${runs} runs`);
  // Memory that is allocated once, e.g. for the first run, is allocated after a third of the time.
  const third = Math.floor(seen.length / 3);
  for (const what of ['console', 'bench', 'page']) {
    const values = seen.map((each) => each[what]), middle = median(values.slice(third, 2 * third)), last = median(values.slice(2 * third));
    console.log(`${what}: ${values[0].toFixed(1)} MB at first, ${middle.toFixed(1)} MB in the second third, ${last.toFixed(1)} MB in the last; at most ${Math.max(...values).toFixed(1)} MB`);
    assert.ok(last < 1.1 * middle + 2, `${what}: ${middle} MB, then ${last} MB`);
  }
});
