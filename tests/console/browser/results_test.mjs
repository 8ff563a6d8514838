// The page of a run shows the numbers that abcal prints.
import assert from 'node:assert/strict';
import {readFileSync} from 'node:fs';
import {abcal, begin, complainsOfNothing, look, says, served} from './page_test.mjs';

const runName = 'first.run';
const step = begin({pace: 8, prepare: () => abcal('run', 'bench.toml', '-o', runName)});

step('shows the result that abcal analyse prints', async (page) => {
  await page.locator('nav a[href="#runs"]').click();
  await page.locator('#run-search').fill('sn 0417 complete');
  await page.getByText('1 of 1 runs').waitFor();
  await look('runs');
  await page.getByRole('link', {name: runName}).click();
  await page.locator('#estimators').waitFor();
  await says('#verdict', /^✓\s*Usable\s+SIMULATED Simulated: stage, accelerometer\. These are no measurements\. /);
  const rows = await page.locator('#estimators tbody tr').evaluateAll((all) => all.map((row) => [...row.children].map((cell) => cell.textContent)));
  assert.equal(rows.length, 18);
  const read = (shown) => Number(shown.replace('−', '-').replace('+', ''));
  for (const [column, estimator] of [[2, 'joint'], [4, 'abc'], [6, 'norm']]) {
    const printed = JSON.parse(abcal('analyse', runName, '--estimator', estimator, '--json'));
    const expected = new Map();
    printed.sensitivity_matrix?.forEach((row, j) => row.forEach((q, k) => expected.set(`s_${'uvw'[j]}${'xyz'[k]}`, q)));
    printed.intrinsic_sensitivity.forEach((q, j) => expected.set(`s_${'uvw'[j]}`, q));
    printed.intrinsic_angle.forEach((q, j) => expected.set(`phi_${['uv', 'vw', 'wu'][j]}`, q));
    printed.offset.forEach((q, j) => expected.set(`O_${'uvw'[j]}`, q));
    let compared = 0;
    for (const row of rows) {
      const q = expected.get(row[0]);
      if (!q || q.value === null) {
        assert.equal(row[column], '–', `${estimator} ${row[0]}`);
        continue;
      }
      const decimals = (row[column].split('.')[1] ?? '').length;
      assert.ok(Math.abs(read(row[column]) - q.value) <= 0.5001 * 10 ** -decimals, `${estimator} ${row[0]}: ${row[column]} for ${q.value}`);
      assert.ok(10 ** -decimals <= q.standard_uncertainty, `${estimator} ${row[0]}: too few digits`);
      assert.ok(Math.abs(read(row[column + 1].replace('−', '-')) / q.standard_uncertainty - 1) <= 0.051, `${estimator} ${row[0]}: u ${row[column + 1]}`);
      if (row[1] !== '1') assert.equal(row[1], q.unit);
      ++compared;
    }
    assert.ok(compared >= 9, `${estimator}: ${compared}`);
  }
  await look('result');
});

step('shows checks, closures, harmonics and step errors that abcal analyse prints', async (page) => {
  const rowsOf = (caption) => page.locator('table', {hasText: caption}).locator('tbody tr')
    .evaluateAll((all) => all.map((row) => [...row.children].map((cell) => cell.textContent)));
  const abc = JSON.parse(abcal('analyse', runName, '--estimator', 'abc', '--json')), joint = JSON.parse(abcal('analyse', runName, '--estimator', 'joint', '--json'));
  const near = (shown, value, what) => assert.ok(Math.abs(Number(shown.replace('−', '-')) - value) <= Math.max(0.06 * Math.abs(value), 6e-6), `${what}: ${shown} for ${value}`);

  const checks = await rowsOf(/Checks that passed/);
  assert.deepEqual(checks.map((row) => row[0]).sort(), joint.diagnostics.checks.map((check) => check.check).sort());
  assert.ok(checks.length >= 8, String(checks.length));
  for (const [name, outcome, , , , meaning] of checks) {
    assert.equal(outcome === 'passed', joint.diagnostics.checks.find((check) => check.check === name).passed, name);
    assert.ok(meaning.length > 20, `${name}: ${meaning}`);
  }
  const closures = await rowsOf('Closures and their');
  assert.equal(closures.length, abc.diagnostics.closures.length);
  closures.forEach((row, i) => near(row[2], abc.diagnostics.closures[i].value.value, row[0]));
  const harmonics = await rowsOf('Amplitudes');
  const expected = abc.diagnostics.fits.flatMap((fit) => fit.harmonics.filter((h) => h.order >= 2).map((h) => Math.hypot(h.sin.value, h.cos.value)));
  assert.equal(harmonics.length, expected.length);
  harmonics.forEach((row, i) => near(row[3], expected[i], `harmonic ${row}`));
  const steps = await rowsOf('Step errors (degrees)');
  const errors = joint.step_error.flat().filter((q) => q.value !== null);
  assert.equal(steps.length, errors.length);
  steps.forEach((row, i) => near(row[2], errors[i].value, `step error ${row}`));
  await page.waitForFunction(() => [...document.querySelectorAll('#run-detail .plot')].filter(({chart}) => chart?.values[0].length > 0).length === 8);
});

step('downloads readings that give the same result', async (page) => {
  const file = await served.download(() => page.getByRole('link', {name: 'Averaged readings (CSV)'}).click());
  const rows = readFileSync(file, 'utf8').split('\n').filter((line) => /^[123],/.test(line));
  assert.ok(rows.length >= 36, String(rows.length));
  const fromCsv = JSON.parse(abcal('analyse', file, '--json')), fromRun = JSON.parse(abcal('analyse', runName, '--json'));
  fromRun.intrinsic_sensitivity.forEach((q, j) => assert.ok(Math.abs(q.value - fromCsv.intrinsic_sensitivity[j].value) < 1e-15));  // A few ulp.
  const report = await served.download(() => page.getByRole('link', {name: 'Report (HTML)'}).click());
  assert.match(readFileSync(report, 'utf8'), /SN 0417/);
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
