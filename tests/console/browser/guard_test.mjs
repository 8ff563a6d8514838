// The page while the process that holds the bench hangs or is dead: the banner shows the state of the axes that their guard reports,
// Stop can be pressed, and nothing is called idle before the guard has confirmed that the axes are at rest.
import assert from 'node:assert/strict';
import {execFileSync} from 'node:child_process';
import {until} from './driven_page.mjs';
import {BENCH, begin, confirmDialog, eventually, served, stateIs, text} from './page_test.mjs';

// In real time, and slow enough for a fault in motion: 30 degrees take six seconds.
const bench = BENCH.replace('port = "simulated"', 'port = "links/stage"').replace('port = "simulated"', 'port = "links/accelerometer"')
  .replaceAll('speed_deg_per_s = 60.0', 'speed_deg_per_s = 5.0').replace('[protocol]', '[protocol]\ncheck_poses = false')
  .replace('dwell_readings = 200', 'dwell_readings = 10');
const CONFIRMED = /Its guard has confirmed that the axes are at rest\./;
process.env.XDG_STATE_HOME = served.folder;  // The log of the guard.
let ask;
const step = begin({bench, prepare: async () => { ask = await served.emulate(); }});

// Records the banner and Stop from now on, in globalThis.seen: [word, sentence, whether Stop could be pressed].
const watch = (page) => page.evaluate(() => {
  globalThis.seen = [];
  const note = () => globalThis.seen.push([document.getElementById('banner-word').textContent, document.getElementById('state').textContent, !document.getElementById('do-stop').disabled]);
  globalThis.watching?.disconnect();
  globalThis.watching = new MutationObserver(note);
  for (const id of ['banner', 'do-stop']) globalThis.watching.observe(document.getElementById(id), {subtree: true, childList: true, characterData: true, attributes: true});
  note();
});
// All of it until the axes were said to be at rest.
async function beforeRest(page, rest) {
  const all = await page.evaluate(() => globalThis.seen);
  const end = all.findIndex(([, sentence]) => rest.test(sentence));
  assert.ok(end > 0, JSON.stringify(all));
  return all.slice(0, end);
}
function stoppableAndNeverIdle(all) {
  for (const [word, sentence, canStop] of all) {
    assert.notEqual(word, 'Idle', sentence);
    assert.ok(canStop, `Stop is grey: ${word}: ${sentence}`);
  }
}

// Waits until an axis has moved by three degrees: it is on the way to the next angle of the plan, or back to the last one.
async function moves() {
  const angles = async () => { const {x, z} = await ask({do: 'status'}); return [x.actual_deg, z.actual_deg]; };
  const before = await angles();
  await until(async () => (await angles()).some((angle, k) => Math.abs(angle - before[k]) > 3), {what: 'a long move'});
}

step('the process hangs in motion: its guard halts the axes, and the banner says when they are at rest', async (page) => {
  await page.locator('#take-control').click();
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await moves();
  await watch(page);
  process.kill(served.holder(), 'SIGSTOP');
  await stateIs(CONFIRMED);
  stoppableAndNeverIdle(await beforeRest(page, CONFIRMED));
  assert.match(await text('#state'), /^The process that holds the bench/, 'and it still hangs');
  await page.locator('#do-stop').becomesEnabled();
  process.kill(served.holder(), 'SIGCONT');
  await stateIs(/^The run is interrupted and can be resumed: .*did not give a sign of life/);
  await page.locator('#do-stop').becomesDisabled();
});

step('an axis is unreachable while the process hangs: the banner says so until the axis is confirmed at rest', async (page) => {
  await page.locator('#resume-interrupted:enabled').click();
  await confirmDialog();
  await moves();
  await watch(page);
  process.kill(served.holder(), 'SIGSTOP');
  await ask({do: 'fault', kind: 'unplug', instrument: 'stage', for_s: 6});
  await stateIs(/Axis X is unreachable since \d\d:\d\d:\d\d UTC and may be moving\./);
  await page.locator('#do-stop:enabled').click();
  await stateIs(CONFIRMED);
  stoppableAndNeverIdle(await beforeRest(page, CONFIRMED));
  process.kill(served.holder(), 'SIGCONT');
  await stateIs(/^The run is interrupted/);
});

step('an axis is unreachable and the process is dead: not at rest until its guard has confirmed it', async (page) => {
  await page.locator('#resume-interrupted:enabled').click();
  await confirmDialog();
  await moves();
  await watch(page);
  process.kill(served.holder(), 'SIGKILL');
  await ask({do: 'fault', kind: 'unplug', instrument: 'stage', for_s: 6});
  await stateIs(/^Axis X is unreachable since \d\d:\d\d:\d\d UTC and may be moving\./);
  assert.equal(await text('#banner-word'), 'Not at rest');
  await page.locator('#do-stop').becomesEnabled();
  await eventually(async () => assert.doesNotMatch(await text('#state'), /unreachable|may be moving/));
  stoppableAndNeverIdle((await page.evaluate(() => globalThis.seen)).filter(([, sentence]) => /unreachable|may be moving/.test(sentence)));
});

step('the process and its guard are dead in motion: nobody is left to say that the axes are at rest, and Stop is not called done', async (page) => {
  await page.locator('#resume-interrupted:enabled').click();
  await confirmDialog();
  await moves();
  await watch(page);
  const holder = served.holder();
  process.kill(holder, 'SIGSTOP');  // Neither may see the other die.
  process.kill(Number(execFileSync('pgrep', ['-P', holder, 'abcal-guard'])), 'SIGKILL');
  process.kill(holder, 'SIGKILL');
  const unseen = /Axis [XZ] may be moving: it was commanded to at \d\d:\d\d:\d\d UTC, and nobody is left who would see it come to rest\./;
  await stateIs(unseen);
  await until(async () => await text('#banner-word') === 'Not known', {what: 'the banner'});
  await page.locator('#do-stop:enabled').click();
  await eventually(async () => assert.match(await text('#halt'), /refused: no guard answers that could halt the stage/));
  assert.match(await text('#state'), unseen);
  stoppableAndNeverIdle(await page.evaluate(() => globalThis.seen));
});
