// The console's page in a real browser, with a simulated bench behind it. Run by ctest, which sets what served_page.mjs
// asks for, and ABCAL_SCREENSHOTS, a folder for pictures of the page.
import assert from 'node:assert/strict';
import {mkdirSync, readFileSync} from 'node:fs';
import path from 'node:path';
import {after, before, test} from 'node:test';
import {missing, PATIENCE, ServedPage, SIZES} from './served_page.mjs';

if (missing()) {
  console.log(`skipped: ${missing()}`);
  process.exit(77);  // ctest's SKIP_RETURN_CODE
}

const BENCH = `
[bench]
name = "Bench 3"
g_loc_mps2 = 9.81
[item]
maker = "Example"
model = "TA-3"
serial_number = "SN 0417"
[operator]
name = "N. N."
[stage]
driver = "pi_gcs"
port = "simulated"
[accelerometer]
driver = "microstrain_mip"
port = "simulated"
rate_hz = 200.0
[protocol]
steps = 12
step_deg = 30.0
settle_s = 0.5
dwell_readings = 200
[simulation]
noise = 1e-4
offset = [0.01, 0.02, 0.03]
sensitivity_matrix = [[1.0021, -0.0047, 0.0037], [0.0069, 0.9982, 0.0086], [-0.0117, 0.0064, 1.0009]]
[simulation.x]
speed_deg_per_s = 60.0
step_error_deg = 0.006
[simulation.z]
speed_deg_per_s = 60.0
step_error_deg = 0.006
`;
const ANGLES = 39;
const served = new ServedPage();
const {folder} = served;
const pictures = process.env.ABCAL_SCREENSHOTS || folder;
let page;

const abcal = (...words) => served.abcal(...words);
const text = (selector) => served.text(selector);
const measured = () => served.measured();
const stateIs = (pattern) => served.stateIs(pattern);
const confirmDialog = () => page.locator('#confirm-yes').click();

before(async () => {
  mkdirSync(pictures, {recursive: true});
  page = await served.open(BENCH, '--pace', '4');
});

after(() => served.close());

// What a person who cannot see the page is told of everything that can be used.
async function unlabelled() {
  return page.evaluate(() => {
    const visible = (element) => element.checkVisibility();
    const nameOf = (element) => {
      const labelledBy = element.getAttribute('aria-labelledby');
      if (labelledBy) return labelledBy.split(' ').map((id) => document.getElementById(id)?.textContent ?? '').join(' ');
      if (element.getAttribute('aria-label')) return element.getAttribute('aria-label');
      if (element.labels && element.labels.length) return element.labels[0].textContent;
      return element.textContent;
    };
    const found = [];
    for (const element of document.querySelectorAll('button, input, select, a[href], [role="img"], canvas, svg, progress, section[aria-labelledby], table'))
      if (visible(element) && element.tagName !== 'TABLE' && !nameOf(element).trim()) found.push(element.outerHTML.slice(0, 120));
    for (const cell of document.querySelectorAll('th')) if (!cell.scope) found.push(`th without scope: ${cell.textContent}`);
    for (const element of document.querySelectorAll('[tabindex]')) if (element.tabIndex > 0) found.push(`tabindex: ${element.outerHTML.slice(0, 80)}`);
    for (const element of document.querySelectorAll('[aria-labelledby]'))
      for (const id of element.getAttribute('aria-labelledby').split(' ')) if (!document.getElementById(id)) found.push(`no element ${id}`);
    const ids = [...document.querySelectorAll('[id]')].map((element) => element.id);
    for (const id of ids) if (ids.indexOf(id) !== ids.lastIndexOf(id)) found.push(`id twice: ${id}`);
    return found;
  });
}

// Columns of numbers that do not say their unit: in their heading, in a column "Unit", or because they count.
async function unitless() {
  return page.evaluate(() => {
    const counts = ['Experiment', 'n', 'Angles'];
    const found = [];
    for (const table of document.querySelectorAll('table')) {
      const heads = [...table.querySelectorAll('thead th')].map((head) => head.textContent);
      if (heads.includes('Unit')) continue;
      for (const cell of table.querySelectorAll('tbody td.number')) {
        const heading = cell.dataset.heading;
        if (!/\(.+\)$/.test(heading) && !counts.includes(heading)) found.push(`${heading}: ${cell.textContent}`);
      }
    }
    return found;
  });
}

// Texts whose contrast to what is behind them is below WCAG 2's 4.5 (what cannot be used now is exempt).
async function faint() {
  return page.evaluate(() => {
    const parse = (colour) => colour.match(/[\d.]+/g).map(Number);
    const luminance = ([r, g, b]) => {
      const [x, y, z] = [r, g, b].map((c) => (c / 255 <= 0.03928 ? c / 255 / 12.92 : ((c / 255 + 0.055) / 1.055) ** 2.4));
      return 0.2126 * x + 0.7152 * y + 0.0722 * z;
    };
    const behind = (element) => {
      for (let at = element; at; at = at.parentElement) {
        const colour = parse(getComputedStyle(at).backgroundColor);
        if (colour.length < 4 || colour[3] === 1) return colour;
      }
      return [255, 255, 255];
    };
    const found = [];
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
      const element = walker.currentNode.parentElement;
      if (!walker.currentNode.textContent.trim() || !element.checkVisibility() || element.closest(':disabled, svg, script, option, .visually-hidden, .skip')) continue;
      const a = luminance(parse(getComputedStyle(element).color)), b = luminance(behind(element));
      const ratio = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      if (ratio < 4.5) found.push(`${ratio.toFixed(2)}: ${element.tagName} "${walker.currentNode.textContent.trim().slice(0, 30)}"`);
    }
    return found;
  });
}

// At both sizes, light and dark: nothing sticks out, all is labelled, and a picture is kept.
async function look(name) {
  for (const [size, viewport] of Object.entries(SIZES)) {
    await page.setViewportSize(viewport);
    for (const colorScheme of ['light', 'dark']) {
      await page.emulateMedia({colorScheme});
      await page.waitForTimeout(300);  // Plots follow the size of their place.
      const [wide, room] = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
      assert.ok(wide <= room, `${name}, ${size}: ${wide} px wide in ${room} px`);
      assert.deepEqual(await unlabelled(), [], name);
      assert.deepEqual(await faint(), [], `${name}, ${colorScheme}`);
      assert.deepEqual(await unitless(), [], name);
      await page.evaluate(() => scrollTo(0, 0));
      await page.screenshot({path: path.join(pictures, `${name}-${size}-${colorScheme}.png`)});
    }
  }
  await page.setViewportSize(SIZES.desk);
  await page.emulateMedia({colorScheme: 'light'});
}

test('says that its stop is no emergency stop', async () => {
  assert.match(await text('#no-emergency'), /no emergency stop/);
});

test('offers nothing before it has control', async () => {
  for (const id of ['do-check', 'do-start', 'do-hold', 'do-continue', 'do-stop', 'do-jog'])
    assert.ok(await page.locator(`#${id}`).isDisabled(), id);
});

test('is used with the keyboard alone: takes control, and asks before it moves the stage', async () => {
  const reached = async (id) => {
    for (let i = 0; i < 40; ++i) {
      await page.keyboard.press('Tab');
      if (await page.evaluate(() => document.activeElement.id) === id) return true;
    }
    return false;
  };
  assert.ok(await reached('take-control'));
  await page.keyboard.press('Enter');
  await page.locator('#do-start:enabled').waitFor();
  assert.ok(await reached('do-start'));
  await page.keyboard.press('Enter');
  assert.ok(await page.locator('#confirm').isVisible());
  assert.equal(await page.evaluate(() => document.activeElement.id), 'confirm-no');
  await page.keyboard.press('Enter');
  assert.ok(await page.locator('#confirm').isHidden());
  assert.equal(await text('#state'), 'No run is in progress.');
});

test('checks the bench', async () => {
  await page.locator('#do-check').click();
  await confirmDialog();
  await page.locator('#checks table').waitFor();
  assert.match(await text('#checks'), /signs and axes/);
  assert.match(await text('#strip-table'), /[+−]\d\.\d{6} g/);
  await page.locator('#do-start:enabled').waitFor();
});

let runName;

test('starts a run, and points appear', async () => {
  await page.locator('#do-start').click();
  await confirmDialog();
  await served.pressAt(8, 'do-hold');
  await page.waitForFunction(() => /^about (\d+ min )?\d+ s$/.test(document.getElementById('left').textContent));
  await served.measuredAtLeast(3);
  runName = await text('#run-file');
  assert.match(runName, /^bench-\d{8}T\d{6}Z\.run$/);
  const drawn = await page.evaluate(() => {
    const [response, residual] = document.querySelectorAll('#responses canvas');
    const points = (canvas) => Chart.getChart(canvas).data.datasets.map((set) => set.data.length);
    return {response: points(response), residual: points(residual), strip: points(document.getElementById('strip'))};
  });
  for (const n of drawn.response.slice(0, 3)) assert.ok(n >= 3, JSON.stringify(drawn));
  for (const n of drawn.strip) assert.ok(n >= 2, JSON.stringify(drawn));
  assert.match(await text('#x-encoder'), /^−?\d+\.\d{4}°$/);
  assert.match(await text('#strip-table'), /[+−]\d\.\d{6} g/);
});

test('holds after an angle, and keeps a note', async () => {
  await stateIs(/^Held/);
  await page.waitForFunction(() => /^(\d+ min )?\d+ s \(held\)$/.test(document.getElementById('left').textContent));  // Told each second.
  const kept = await measured();
  await page.locator('#note').fill('<b>door opened</b>');
  await page.locator('#note').press('Enter');
  await page.getByText('Note, stored in the event log: <b>door opened</b>').waitFor();
  await look('live');
  assert.equal(await measured(), kept);
});

test('another page watches, and steers only after it took control', async () => {
  const other = served.watch(await served.browser.newPage());
  await other.goto(served.address);
  await served.measuredAtLeast(8, other);
  assert.ok(await other.locator('#do-stop').isDisabled());
  await other.locator('#take-control').click();
  await other.locator('#confirm-yes').click();
  await other.locator('#do-stop:enabled').waitFor();
  assert.ok(await page.locator('#do-stop').isDisabled());
  await other.close();
  await page.locator('#take-control').click();
  await page.locator('#do-stop:enabled').waitFor();
});

test('continues, stops at once, and resumes from the list of runs', async () => {
  const held = await measured();
  await page.locator('#do-continue').click();
  await served.pressAt(held + 1, 'do-stop');
  await confirmDialog();
  await stateIs(/^The run is interrupted and can be resumed: .*the stage is halted/);
  const kept = await measured();
  assert.ok(kept > held && kept < ANGLES, `${held} then ${kept}`);
  await page.locator('nav a[href="#runs"]').click();
  await page.locator(`button.resume[data-run="${runName}"]:enabled`).click();
  await confirmDialog();
  await page.locator('#view-live').waitFor();
  await stateIs(/^The run is complete\. Result: usable/);
  assert.equal(await measured(), ANGLES);
});

test('shows the result that abcal analyse prints', async () => {
  await page.locator('nav a[href="#runs"]').click();
  await page.locator('#run-search').fill('sn 0417 complete');
  await page.getByText('1 of 1 runs').waitFor();
  await look('runs');
  await page.getByRole('link', {name: runName}).click();
  await page.locator('#estimators').waitFor();
  assert.match(await text('#verdict'), /^Usable\./);
  assert.match(await text('#verdict'), /interrupted and went on once/);
  const rows = await page.locator('#estimators tbody tr').evaluateAll((all) => all.map((row) => [...row.children].map((cell) => cell.textContent)));
  assert.equal(rows.length, 18);
  const read = (shown) => Number(shown.replace('−', '-').replace('+', ''));
  for (const [column, estimator] of [[2, 'abc'], [4, 'joint'], [6, 'norm']]) {
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

test('shows checks, closures, harmonics and step errors that abcal analyse prints', async () => {
  const rowsOf = (caption) => page.locator('table', {has: page.locator('caption', {hasText: caption})}).locator('tbody tr')
    .evaluateAll((all) => all.map((row) => [...row.children].map((cell) => cell.textContent)));
  const abc = JSON.parse(abcal('analyse', runName, '--json')), joint = JSON.parse(abcal('analyse', runName, '--estimator', 'joint', '--json'));
  const near = (shown, value, what) => assert.ok(Math.abs(Number(shown.replace('−', '-')) - value) <= Math.max(0.06 * Math.abs(value), 6e-6), `${what}: ${shown} for ${value}`);

  const checks = await rowsOf(/checks? (passed|failed)/);
  assert.deepEqual(checks.map((row) => row[0]).sort(), abc.diagnostics.checks.map((check) => check.check).sort());
  assert.ok(checks.length >= 8, String(checks.length));
  for (const [name, outcome, , , , meaning] of checks) {
    assert.equal(outcome === 'passed', abc.diagnostics.checks.find((check) => check.check === name).passed, name);
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
  const drawn = await page.evaluate(() => [...document.querySelectorAll('#run-detail canvas')].map((canvas) => Chart.getChart(canvas).data.datasets[0].data.length));
  assert.equal(drawn.length, 5);
  for (const points of drawn) assert.ok(points > 0, JSON.stringify(drawn));
});

test('downloads readings that give the same result', async () => {
  const [download] = await Promise.all([page.waitForEvent('download'), page.getByRole('link', {name: 'Averaged readings (CSV)'}).click()]);
  const file = path.join(folder, 'fetched.csv');
  await download.saveAs(file);
  const rows = readFileSync(file, 'utf8').split('\n').filter((line) => /^[123],/.test(line));
  assert.ok(rows.length >= 36, String(rows.length));
  const fromCsv = JSON.parse(abcal('analyse', file, '--json')), fromRun = JSON.parse(abcal('analyse', runName, '--json'));
  fromRun.intrinsic_sensitivity.forEach((q, j) => assert.ok(Math.abs(q.value - fromCsv.intrinsic_sensitivity[j].value) < 1e-15));  // A few ulp.
  const [report] = await Promise.all([page.waitForEvent('download'), page.getByRole('link', {name: 'Report (HTML)'}).click()]);
  await report.saveAs(path.join(folder, 'report.html'));
  assert.match(readFileSync(path.join(folder, 'report.html'), 'utf8'), /SN 0417/);
});

test('compares two runs and shows the control chart of an item', async () => {
  await page.goto(`${served.address}#live`);
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await stateIs(/^(?!The run is complete)/);  // the words are still those of the run before
  await stateIs(/^The run is complete/);
  await page.locator('nav a[href="#compare"]').click();
  await page.locator('#compare-form button').click();
  await page.locator('#compare-words').waitFor();
  assert.equal(await page.locator('#compare-table tbody tr').count(), 9);
  await look('compare');
  await page.locator('nav a[href="#chart"]').click();
  await page.locator('#chart-words').waitFor();
  await page.waitForFunction(() => document.querySelectorAll('#chart-body tbody tr').length >= 2);
  assert.equal(await page.locator('#chart-body tbody tr').count(), 2);
  assert.match(await text('#chart-words'), /^Centre [\d.]+ g\/g_loc; limits/);
  await look('chart');
});

test('jogs an axis', async () => {
  await page.locator('nav a[href="#live"]').click();
  await page.locator('#jog-axis').selectOption('z');
  await page.locator('#jog-by').fill('-7.5');
  await page.locator('#do-jog').click();
  await confirmDialog();
  await page.getByText(/Axis Z stands at -7\.50\d+ degrees/).waitFor();
});

test('connects again by itself, and the bench does not depend on it', async () => {
  await page.context().setOffline(true);
  await page.context().setOffline(false);
  await page.reload();
  await page.waitForFunction(() => document.getElementById('link').textContent === 'Connected');
});

test('loaded nothing from elsewhere, and the browser has nothing to complain of', () => {
  assert.deepEqual(served.requests.filter((url) => !url.startsWith(served.address) && !url.startsWith('blob:')), []);
  assert.deepEqual(served.problems, []);
});
