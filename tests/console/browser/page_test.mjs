// What every test of the console's page begins and ends with. Each test program serves a page of its own and fails within
// 60 s, whatever it waits for; a picture of each view is kept in ABCAL_SCREENSHOTS.
import assert from 'node:assert/strict';
import {mkdirSync} from 'node:fs';
import path from 'node:path';
import {after, before, test} from 'node:test';
import {missing, ServedPage, SIZES} from './served_page.mjs';

const LONGEST = 55_000;  // ms; ctest ends what is not over after 60 s

if (missing()) {
  console.log(`skipped: ${missing()}`);
  process.exit(77);  // ctest's SKIP_RETURN_CODE
}

export const BENCH = `
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
export const ANGLES = 47;  // With eight visits to check poses.
export const served = new ServedPage();
const {folder} = served;
const pictures = process.env.ABCAL_SCREENSHOTS || folder;
let page;

export const abcal = (...words) => served.abcal(...words);
export const text = (selector) => served.text(selector);
export const measured = () => served.measured();
export const stateIs = (pattern) => served.stateIs(pattern);
export const confirmDialog = () => page.locator('#confirm-yes').click();

// Opens the page of a console that serves the bench; `prepare` is done before, e.g. runs are made, and `enter` until the page
// of the bench is there. Says at the end of the
// test program which step it was in, if that took too long.
export function begin({pace, bench = BENCH, prepare = () => {}, serve = [], enter = () => served.entered()}) {
  let step = 'opening the page';
  const watchdog = setTimeout(() => {
    console.error(`not over after ${LONGEST / 1000} s, in: ${step}`);
    served.kill();
    process.exit(1);
  }, LONGEST);
  before(async () => {
    mkdirSync(pictures, {recursive: true});
    served.describe(bench);
    await prepare();
    await served.goToConsole(bench, '--pace', String(pace), ...serve);
    page = served.page;
    await enter();
  });
  after(async () => {
    step = 'closing the page';
    await served.close();
    clearTimeout(watchdog);
  });
  return (name, run) => test(name, async () => {
    step = name;
    await run(page);
  });
}

// The last step of each test program.
export function complainsOfNothing() {
  assert.deepEqual(served.requests.filter((url) => !url.startsWith(served.address) && !url.startsWith('blob:')), []);
  assert.deepEqual(served.problems, []);
}

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
      if (visible(element) && !element.closest('[aria-hidden="true"]') && element.tagName !== 'TABLE' && !nameOf(element).trim()) found.push(element.outerHTML.slice(0, 120));
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
export async function look(name) {
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
