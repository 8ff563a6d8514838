// The console's page in a real browser, with a simulated bench behind it. Run by ctest, which sets
//   ABCAL_PROGRAM         the program abcal
//   ABCAL_NODE_MODULES    where playwright-core is installed
//   ABCAL_SCREENSHOTS     folder for pictures of the page
import assert from 'node:assert/strict';
import {execFileSync, spawn} from 'node:child_process';
import {existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync} from 'node:fs';
import {createRequire} from 'node:module';
import {tmpdir} from 'node:os';
import path from 'node:path';
import {after, before, test} from 'node:test';

const CHROMIUM = process.env.ABCAL_CHROMIUM || '/usr/bin/chromium';
const modules = process.env.ABCAL_NODE_MODULES;
const skipped = 77;  // ctest's SKIP_RETURN_CODE
if (!modules || !existsSync(path.join(modules, 'playwright-core'))) {
  console.log('skipped: playwright-core is not installed');
  process.exit(skipped);
}
if (!existsSync(CHROMIUM)) {
  console.log(`skipped: there is no ${CHROMIUM}`);
  process.exit(skipped);
}
const {chromium} = createRequire(path.join(modules, 'x.js'))('playwright-core');

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
const PATIENCE = 120_000;  // ms; a busy machine is slow, and a run takes some seconds on a fast one

const folder = mkdtempSync(path.join(tmpdir(), 'abcal-page-'));
const pictures = process.env.ABCAL_SCREENSHOTS || folder;
let server, address, browser, page;
const requests = [], problems = [];

const abcal = (...words) => execFileSync(process.env.ABCAL_PROGRAM, words, {cwd: folder, encoding: 'utf8', stdio: ['ignore', 'pipe', 'ignore']});
const text = (selector) => page.locator(selector).innerText();
const confirmDialog = () => page.locator('#confirm-yes').click();

function watch(opened) {
  opened.setDefaultTimeout(PATIENCE);
  opened.on('request', (request) => requests.push(request.url()));
  opened.on('pageerror', (error) => problems.push(String(error)));
  opened.on('console', (message) => { if (['error', 'warning'].includes(message.type())) problems.push(message.text()); });
  return opened;
}

async function stateIs(pattern) {
  await page.waitForFunction((source) => new RegExp(source).test(document.getElementById('state').textContent), pattern.source, {timeout: PATIENCE});
}

const measured = async () => Number((await text('#measured')).split(' ')[0]);

before(async () => {
  mkdirSync(pictures, {recursive: true});
  writeFileSync(path.join(folder, 'bench.toml'), BENCH);
  server = spawn(process.env.ABCAL_PROGRAM, ['serve', 'bench.toml', '--port', '0', '--pace', '10'], {cwd: folder, stdio: ['ignore', 'pipe', 'inherit']});
  address = await new Promise((resolve, reject) => {
    let said = '';
    server.stdout.on('data', (bytes) => {
      said += bytes;
      const found = said.match(/Console: (http:\S+)/);
      if (found) resolve(found[1]);
    });
    server.on('exit', (code) => reject(new Error(`abcal serve ended with ${code}`)));
  });
  browser = await chromium.launch({executablePath: CHROMIUM, headless: true, args: ['--headless', '--no-sandbox', '--disable-gpu', '--disable-quic',
    '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync']});
  page = watch(await browser.newPage({viewport: {width: 1366, height: 768}, acceptDownloads: true}));
  await page.goto(address);
  await page.waitForFunction(() => document.getElementById('link').textContent === 'Connected');
});

after(async () => {
  await browser?.close();
  server?.kill('SIGINT');
  rmSync(folder, {recursive: true, force: true});
});

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

const SIZES = {desk: {width: 1366, height: 768}, phone: {width: 390, height: 844}};

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
  assert.equal(await text('#state'), 'No run is on.');
});

test('checks the bench', async () => {
  await page.locator('#do-check').click();
  await confirmDialog();
  await page.locator('#checks table').waitFor();
  assert.match(await text('#checks'), /signs and axes/);
  await page.locator('#do-start:enabled').waitFor();
});

let runName;

test('starts a run, and points appear', async () => {
  await page.locator('#do-start').click();
  await confirmDialog();
  await page.waitForFunction(() => Number(document.getElementById('measured').textContent.split(' ')[0]) >= 3);
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
  assert.match(await text('#left'), /about \d+ s/);
});

test('holds after an angle, keeps a note, and continues', async () => {
  await page.waitForFunction(() => Number(document.getElementById('measured').textContent.split(' ')[0]) >= 8);  // A fit and residuals to look at.
  await page.locator('#do-hold').click();
  await stateIs(/^Held/);
  const kept = await measured();
  await page.locator('#note').fill('<b>door opened</b>');
  await page.locator('#note').press('Enter');
  await page.getByText('Note, stored in the event log: <b>door opened</b>').waitFor();
  await look('live');
  assert.equal(await measured(), kept);
  await page.locator('#do-continue').click();
  await confirmDialog();
  await page.waitForFunction((n) => Number(document.getElementById('measured').textContent.split(' ')[0]) > n, kept);
});

test('another page watches, and steers only after it took control', async () => {
  const other = watch(await browser.newPage());
  await other.goto(address);
  await other.waitForFunction(() => Number(document.getElementById('measured').textContent.split(' ')[0]) >= 8);
  assert.ok(await other.locator('#do-stop').isDisabled());
  await other.locator('#take-control').click();
  await other.locator('#confirm-yes').click();
  await other.locator('#do-stop:enabled').waitFor();
  assert.ok(await page.locator('#do-stop').isDisabled());
  await other.close();
  await page.locator('#take-control').click();
  await page.locator('#do-stop:enabled').waitFor();
});

test('stops at once, and resumes from the list of runs', async () => {
  await page.locator('#do-stop').click();
  await stateIs(/^The run is interrupted and can be resumed: .*the stage is halted/);
  const kept = await measured();
  assert.ok(kept < ANGLES);
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
  await page.goto(`${address}#live`);
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
  assert.deepEqual(requests.filter((url) => !url.startsWith(address) && !url.startsWith('blob:')), []);
  assert.deepEqual(problems, []);
});
