// A console that is flooded during a run: a thousand silent connections, requests that arrive byte by byte, and requests as fast
// as they are answered. Others are served, the run goes on, and afterwards memory and descriptors are as before.
import assert from 'node:assert/strict';
import {readdirSync, readFileSync} from 'node:fs';
import http from 'node:http';
import net from 'node:net';
import {after, before, test} from 'node:test';
import {eventually, until} from './driven_page.mjs';
import {ENDLESS} from './page_test.mjs';
import {fromRegistry, ServedPage} from './served_page.mjs';

const LONGEST_ANSWER = 1000, LONGEST_SILENCE = 3000;  // ms; after the latter a page reports no contact
const WebSocket = fromRegistry('ws');
const served = new ServedPage();
const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));
const watchdog = setTimeout(() => { console.error('not over after 110 s'); served.kill(); process.exit(1); }, 110_000);
let port, page, measured = 0, heard, silence = 0, again = 0;

const memory = () => Number(readFileSync(`/proc/${served.server.pid}/status`, 'utf8').match(/VmRSS:\s+(\d+)/)[1]) / 1024;  // MB
const descriptors = () => readdirSync(`/proc/${served.server.pid}/fd`).length;
const connect = () => {
  const socket = net.connect(port, '127.0.0.1');
  socket.on('error', () => {});  // The console may end it.
  return socket;
};

function get(agent = false) {
  return new Promise((resolve, reject) => {
    http.get({host: '127.0.0.1', port, path: '/', agent}, (response) => {
      response.resume();
      response.on('end', () => (response.statusCode === 200 ? resolve() : reject(new Error(`answered ${response.statusCode}`))));
    }).on('error', reject);
  });
}

// How long one answer takes, in ms. Among a thousand new connections, this one may be ended as the oldest silent one; a browser
// then asks again.
async function ask(agent = false) {
  const asked = performance.now();
  for (;; ++again) {
    try {
      await get(agent);
      return performance.now() - asked;
    } catch (error) {
      if (!['ECONNRESET', 'EPIPE'].includes(error.code)) throw error;
    }
  }
}

before(async () => {
  served.describe(ENDLESS);
  served.address = await served.serve('--pace', '1');
  port = Number(new URL(served.address).port);
  page = new WebSocket(`ws://127.0.0.1:${port}/live`, {origin: `http://127.0.0.1:${port}`});
  let id = 0;
  const answers = new Map();
  page.on('message', (bytes) => {
    const message = JSON.parse(bytes);
    if (message.type === 'beat') {
      const now = performance.now();
      silence = Math.max(silence, now - (heard ?? now));
      heard = now;
      page.send('{"do":"beat"}');
    }
    if (message.event === 'dwell_done') ++measured;
    if (message.type === 'reply') answers.get(message.id)(message);
  });
  await new Promise((resolve) => page.on('open', resolve));
  const request = (what) => new Promise((resolve) => { answers.set(++id, resolve); page.send(JSON.stringify({...what, id})); });
  assert.ok((await request({do: 'control'})).ok);
  await until(async () => (await request({do: 'start', confirmed: true})).ok, {what: 'the process that holds the bench'});
  await until(() => measured >= 1 && heard, {what: 'the run'});
});
after(async () => {
  page.close();
  served.kill();
  clearTimeout(watchdog);
});

// While `floods` lasts, others are served and the run goes on; afterwards memory and descriptors are as before.
async function holdsUpNobody(floods) {
  const before = {memory: memory(), descriptors: descriptors(), measured};
  silence = again = 0;
  let on = true, longest = 0, answers = 0;
  const other = (async () => { for (; on; await pause(100)) { longest = Math.max(longest, await ask()); ++answers; } })();
  const words = await floods();
  await until(() => measured > before.measured, {what: 'the next angle'});
  on = false;
  await other;
  await eventually(() => assert.ok(descriptors() <= before.descriptors + 3, `${descriptors()} descriptors, before ${before.descriptors}`));
  const grown = memory() - before.memory;
  console.log(`${words}; ${answers} other answers, the longest after ${longest.toFixed(0)} ms, ${again} asked for again; beats at most ${silence.toFixed(0)} ms apart; memory ${grown.toFixed(1)} MB more`);
  assert.ok(longest < LONGEST_ANSWER, `${longest} ms for an answer`);
  assert.ok(silence < LONGEST_SILENCE, `${silence} ms without a beat`);
  assert.ok(grown < 20, `${grown} MB more`);
}

test('a thousand connections that say nothing', () => holdsUpNobody(async () => {
  const silent = Array.from({length: 1000}, connect);
  await pause(3000);
  const open = silent.filter((socket) => !socket.destroyed && socket.readyState === 'open').length;
  for (const socket of silent) socket.destroy();
  return `1000 connections, ${open} of them kept`;
}));

test('requests that come byte by byte', () => holdsUpNobody(async () => {
  const request = `GET / HTTP/1.1\r\nHost: 127.0.0.1:${port}\r\nX: ${'x'.repeat(1000)}`;
  const slow = Array.from({length: 200}, connect);
  let ended = 0;
  for (const socket of slow) socket.on('close', () => ++ended);
  // The console waits 10 s for a request.
  for (let i = 0; ended < slow.length && i < request.length; ++i, await pause(100)) for (const socket of slow) if (!socket.destroyed) socket.write(request[i]);
  assert.equal(ended, slow.length, 'all are ended');
  return '200 slow requests';
}));

test('requests as fast as they are answered', () => holdsUpNobody(async () => {
  const agent = new http.Agent({keepAlive: true, maxSockets: 40}), end = performance.now() + 5000;
  let count = 0;
  await Promise.all(Array.from({length: 40}, async () => { while (performance.now() < end) { await ask(agent); ++count; } }));
  agent.destroy();
  return `${count} requests in 5 s`;
}));
