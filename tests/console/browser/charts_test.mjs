// The control chart of a check standard: its approved baseline in the register, and a later run that is outside.
import assert from 'node:assert/strict';
import {BENCH, abcal, barriers, begin, look, noEnglish, served, text} from './page_test.mjs';
import {logIn, makeRegister} from './training_register.mjs';

const RUNS = 6;
const bench = BENCH.replace('[operator]\nname = "N. N."\n', '');
const step = begin({bench, enter: () => {}, prepare: () => {
  const lab = makeRegister(served);
  lab('add', 'item', '--maker', 'MicroStrain', '--model', '3DM-GV7-AR', '--serial-number', 'SN 0417');
  const names = [];
  for (let seed = 1; seed <= RUNS + 1; ++seed) {
    // The last run is that of an item whose offset has changed.
    const offset = seed > RUNS ? 'offset = [0.02, 0.02, 0.03]' : 'offset = [0.01, 0.02, 0.03]';
    served.describe(bench.replace('noise = 1e-4', `seed = ${seed}\nnoise = 1e-4`).replace('offset = [0.01, 0.02, 0.03]', offset));
    abcal('run', 'bench.toml', '-o', `check-${seed}.run`);
    names.push(`check-${seed}.run`);
  }
  lab('chart', 'approve', 'SN-0417', ...names.slice(0, RUNS));
  try { lab('chart', 'add', 'SN-0417', names[RUNS]); } catch { /* A run outside ends with an exit code. */ }
}});

step('shows the approved baseline, its limits, and the run that is outside', async (page) => {
  await logIn(page, 'Operator N. N.');
  await served.entered();
  await served.goTo('chart');
  await page.waitForFunction(() => document.querySelector('#chart-item option[value="register:SN-0417"]'));
  await page.locator('#chart-item').selectOption('register:SN-0417');
  await page.locator('#chart-property').selectOption('O_u');
  await page.locator('#chart-words').says(/^Approved by Admin N\. N\.: centre .* g; single values within .*\. The bench is blocked\.$/);
  await page.locator('#chart-body .scroll-x tbody tr').countIs(RUNS + 1);
  assert.match(await text('#chart-body .scroll-x tbody tr:last-child'), /OUTSIDE: single value/);
  assert.deepEqual(await page.evaluate(() => { const {chart} = document.querySelector('#chart-body .plot'); return [[...chart.rings], chart.levels.length]; }), [[RUNS], 3]);
  await look('frozen-chart');
});

step('says so in German too', async (page) => {
  await page.locator('#language').click();
  await page.waitForFunction(() => document.documentElement.lang === 'de' && document.getElementById('link').textContent === 'Verbunden');
  await page.waitForFunction(() => document.querySelector('#chart-item option[value="register:SN-0417"]'));
  await page.locator('#chart-item').selectOption('register:SN-0417');
  await page.locator('#chart-words').says(/^Freigegeben von Admin N\. N\./);
  await noEnglish();
  assert.deepEqual(await barriers(), []);
});
