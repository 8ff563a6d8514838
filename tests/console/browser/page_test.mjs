// The common begin and end of all tests of the console's page. Each test program serves a page of its own and fails within 60 s
// (ABCAL_LONGEST_S, if it is a long one), whatever it waits for; a picture of each view is kept in ABCAL_SCREENSHOTS.
import assert from 'node:assert/strict';
import {mkdirSync} from 'node:fs';
import path from 'node:path';
import {after, before, test} from 'node:test';
import {eventually} from './driven_page.mjs';
import {browserName, fromRegistry, missing, ServedPage, SIZES} from './served_page.mjs';

const LONGEST = 1000 * Number(process.env.ABCAL_LONGEST_S || 55);  // ms; a little less than ctest's own limit

if (missing()) {
  console.log(`skipped: ${missing()}`);
  process.exit(77);  // ctest's SKIP_RETURN_CODE
}

export const BENCH = `
[bench]
name = "Bench 3"
g_loc_mps2 = 9.81
[item]
maker = "MicroStrain"
model = "3DM-GV7-AR"
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
serial_number = "SN 0417"
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
// The same bench with 119 angles: at pace 5 or less no test sees the end of its run.
export const ENDLESS = BENCH.replace('steps = 12\nstep_deg = 30.0', 'steps = 36\nstep_deg = 10.0');
export const served = new ServedPage();
const {folder} = served;
const pictures = process.env.ABCAL_SCREENSHOTS || folder;
let page;

export {eventually};
export const abcal = (...words) => served.abcal(...words);
// The visible text of an element now; `says` waits until it equals a text or matches a pattern.
export const text = (selector) => served.text(selector);
export const says = (selector, words) => page.locator(selector).says(words);
export const measured = () => served.measured();
export const stateIs = (pattern) => served.stateIs(pattern);
export const confirmDialog = () => page.locator('#confirm-yes').click();

// Opens the page of a console that serves the bench. `prepare` runs before, e.g. to make runs; `enter` leads to the page of the
// bench.
// If the test program takes too long, it ends with the name of the step.
export function begin({pace = null, bench = BENCH, prepare = () => {}, serve = [], enter = () => served.entered()}) {
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
    await served.goToConsole(bench, ...(pace ? ['--pace', String(pace)] : []), ...serve);
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

// Clicks from the number of flagged angles in the banner to the single readings of an angle with this flag.
export async function clicksToReadings(flag) {
  let clicks = 0;
  const click = async (selector, of) => { await page.locator(selector, of).first().click(); ++clicks; };
  await click('#flagged a');
  await page.locator('.flagged-angle', {hasText: flag}).waitFor();
  await click('.flagged-angle', {hasText: flag});
  await page.locator('#angle-readings .plot').waitFor();
  return clicks;
}

// The place of the first value on the page, in parts of the height of the screen, and what it is.
export const firstDatum = (page) => page.evaluate(() => {
  const found = [...document.querySelectorAll('dd, tbody td, tbody th, progress, .verdict-word, #chart-words')]
    .filter((element) => element.checkVisibility({visibilityProperty: true}) && element.textContent.trim() !== '–')
    .map((element) => ({at: (element.getBoundingClientRect().top + scrollY) / innerHeight, is: element.id || element.textContent.slice(0, 30)}));
  return found.sort((a, b) => a.at - b.at)[0] ?? null;
});

// The last step of each test program.
export function complainsOfNothing() {
  assert.deepEqual(served.requests.filter((url) => !url.startsWith(served.address) && !/^(blob|data):/.test(url)), []);
  assert.deepEqual(served.problems, []);
}

export const pictureOf = (where, name) => where.screenshot({path: path.join(pictures, `${name}.png`)});

// Pictures in high contrast, of a laptop and of a narrow screen; only Chromium can be told to.
export async function contrastPictures(name, seen = () => {}) {
  if (browserName !== 'chromium') return;
  const session = await page.page.createCDPSession();
  await session.send('Emulation.setEmulatedMedia', {features: [{name: 'forced-colors', value: 'active'}, {name: 'prefers-reduced-motion', value: 'reduce'}]});
  await page.waitForFunction(() => matchMedia('(forced-colors: active)').matches && matchMedia('(prefers-reduced-motion: reduce)').matches);
  await seen();
  for (const [size, viewport] of Object.entries({desk: SIZES.desk, narrow: SIZES.narrow})) {
    await page.setViewportSize(viewport);
    await pictureOf(page, `contrast-${name}-${size}`);
  }
  await page.setViewportSize(SIZES.desk);
  await session.send('Emulation.setEmulatedMedia', {features: []});
}

// The findings of axe on accessibility: names, order, contrast (WCAG 2.2 A and AA, good practice).
// Or what one of its rules finds.
export async function barriers(where = page, rules = null) {
  if (!(await where.evaluate(() => 'axe' in globalThis))) await where.evaluate(`${fromRegistry('axe-core').source}; 0`);
  const {violations, passes} = await where.evaluate((only) => axe.run({
    runOnly: only ? {type: 'rule', values: only} : ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice'], resultTypes: ['violations']}), rules);
  assert.ok(passes.length >= (rules?.length ?? 10), 'axe has looked');
  return violations.flatMap(({id, nodes}) => nodes.map(({html, failureSummary}) => `${id}: ${html.slice(0, 160)} ${failureSummary}`));
}

// English words on a German page where none is expected.
const english = () => served.page.evaluate(() => {
  const word = /\b(the|of|is|are|and|to|by|with|for|has|its|this|that|no|run|runs|value|angles?|stage|settling|held|taken|time|times|unit|check|show|start|output)\b/i;
  const found = [];
  const say = (element, text) => { if (word.test(text) && !element.closest('[lang=en], code, script')) found.push(`${element.tagName}#${element.id}: ${text.trim().slice(0, 80)}`); };
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) say(walker.currentNode.parentElement, walker.currentNode.data.replace(/\S+\.(run|toml)\b/g, ''));
  for (const name of ['aria-label', 'title']) for (const element of document.querySelectorAll(`[${name}]`)) say(element, element.getAttribute(name).replace(/\S+\.(run|toml)\b/g, ''));
  for (const plot of document.querySelectorAll('.plot'))
    for (const {label} of plot.chart?.plot.axes ?? []) say(plot, label);
  return found;
});

export const noEnglish = () => eventually(async () => assert.deepEqual(await english(), []));

// The page is open, and German.
export async function inGerman() {
  await served.entered();
  await page.locator('#language').click();
  await page.waitForFunction(() => document.documentElement.lang === 'de' && document.getElementById('link').textContent === 'Verbunden');
}

// Why a person would not see where the focus is; null if all is well.
export const unseen = (where) => where.evaluate(() => {
  const element = document.activeElement, name = element?.outerHTML.slice(0, 100);
  if (!document.hasFocus() || !element || element === document.body) return 'nothing has the focus';  // Or one of the browser's own controls.
  if (element.matches(':disabled')) return `it cannot be used: ${name}`;
  const {outlineStyle, outlineWidth} = getComputedStyle(element);
  if (outlineStyle === 'none' || parseFloat(outlineWidth) < 2) return `no outline: ${name}`;
  const {left, right, top, bottom} = element.getBoundingClientRect(), banner = document.getElementById('top');
  const [x, y] = [(left + right) / 2, Math.min(Math.max((top + bottom) / 2, banner.getBoundingClientRect().bottom + 2), innerHeight - 2)];
  if (banner.contains(element) || element.classList.contains('skip')) return null;
  if (bottom <= banner.getBoundingClientRect().bottom || top >= innerHeight) return `out of sight: ${name}`;
  const hit = document.elementFromPoint(x, y);
  return element.contains(hit) || hit?.contains(element) ? null : `under ${hit?.outerHTML.slice(0, 60)}: ${name}`;
});

// Names in a list of facts that are wider than their place, and overlap the text next to them.
export const runOver = () => page.evaluate(() => [...document.querySelectorAll('dt')]
  .filter((name) => name.checkVisibility() && name.scrollWidth > name.clientWidth + 1).map((name) => name.textContent));

// Texts that extend beyond the side or are cut off, and cannot be scrolled to.
async function lost() {
  return page.evaluate(() => {
    const found = [];
    const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
      const element = walker.currentNode.parentElement, text = walker.currentNode.textContent.trim();
      if (!text || !element.checkVisibility() || element.closest('svg, script, option, .visually-hidden, .skip')) continue;
      const range = document.createRange();
      range.selectNodeContents(walker.currentNode);
      const {left, right} = range.getBoundingClientRect();
      let reachable = false;
      for (let at = element; at && !reachable; at = at.parentElement) {
        const {overflowX} = getComputedStyle(at), box = at.getBoundingClientRect();
        if (['auto', 'scroll'].includes(overflowX)) reachable = true;
        else if (['hidden', 'clip'].includes(overflowX) && (right > box.right + 1 || left < box.left - 1)) break;
      }
      if (!reachable && (right > innerWidth + 1 || left < -1)) found.push(`${element.tagName} "${text.slice(0, 40)}": ${Math.round(left)} to ${Math.round(right)} px`);
      const button = element.closest('button, select, a.button');
      if (button && (button.scrollWidth > button.clientWidth + 1 || button.scrollHeight > button.clientHeight + 1)) found.push(`${button.tagName} "${text.slice(0, 40)}" is too small for its words`);
    }
    return found;
  });
}

// Columns of numbers without a unit: neither in the heading nor in a column "Unit", and not a count.
async function unitless() {
  return page.evaluate(() => {
    const counts = ['Experiment', 'n', 'Angles', 'Winkel'];
    const found = [];
    for (const table of document.querySelectorAll('table')) {
      const heads = [...table.querySelectorAll('thead th')].map((head) => head.textContent);
      if (heads.includes('Unit') || heads.includes('Einheit')) continue;
      for (const cell of table.querySelectorAll('tbody td.number')) {
        const heading = cell.dataset.heading;
        if (!/\(.+\)$/.test(heading) && !counts.includes(heading)) found.push(`${heading}: ${cell.textContent}`);
      }
    }
    return found;
  });
}

// Waits until the page has the size, its plots fill their places, and the colour scheme is the requested one.
const settled = (viewport, colorScheme) => page.waitForFunction(([{width, height}, scheme]) => {
  const fits = (plot) => !plot.chart || plot.clientWidth < 120 || Math.abs(plot.chart.plot.width - plot.clientWidth) <= 1;
  return innerWidth === width && innerHeight === height && matchMedia(`(prefers-color-scheme: ${scheme})`).matches
    && [...document.querySelectorAll('.plot')].every((plot) => !plot.checkVisibility() || fits(plot));
}, [viewport, colorScheme]);

// Charts whose lines still have the colours of the previous scheme. (The login page has no charts.)
const strangeColours = () => page.evaluate(() => [...document.querySelectorAll('.plot')].filter((place) => place.chart && place.checkVisibility()).flatMap(({chart}) => chart.series
  .filter(({output, line}, i) => line && chart.values[i + 1].some((value) => value !== null) && chart.plot.series[i + 1]._stroke !== getComputedStyle(document.documentElement).getPropertyValue(`--${output}`).trim())
  .map(({label}) => `${chart.holder.getAttribute('aria-label')}: ${label}`)));

// At each size, light and dark: nothing overflows, is cut off or moves by itself, axe finds nothing, and a picture is kept. Axe
// takes most of the time: it runs where the layout differs, and for colours only where only these differ.
export async function look(name) {
  for (const [size, viewport] of Object.entries(SIZES)) {
    await page.setViewportSize(viewport);
    for (const colorScheme of browserName === 'chromium' && ['desk', 'phone'].includes(size) ? ['light', 'dark'] : ['light']) {
      await page.emulateMedia({'prefers-color-scheme': colorScheme});
      await settled(viewport, colorScheme);
      const where = `${name}, ${size}, ${colorScheme}`;
      await eventually(async () => {
        const [wide, room] = await page.evaluate(() => [document.documentElement.scrollWidth, innerWidth]);
        assert.ok(wide <= room, `${where}: ${wide} px wide in ${room} px`);
        assert.deepEqual(await lost(), [], where);
        assert.deepEqual(await runOver(), [], where);
        assert.equal(await page.evaluate(() => document.getAnimations().length), 0, `${where}: nothing moves by itself`);
        assert.deepEqual(await unitless(), [], where);
        assert.deepEqual(await strangeColours(), [], where);
        if (colorScheme === 'dark' && size === 'desk') assert.deepEqual(await barriers(page, ['color-contrast']), [], where);
        else if (['desk', 'narrow'].includes(size)) assert.deepEqual(await barriers(), [], where);
      });
      await page.evaluate(() => scrollTo(0, 0));
      await page.screenshot({path: path.join(pictures, `${name}-${size}-${colorScheme}${browserName === 'chromium' ? '' : `-${browserName}`}.png`)});
    }
  }
  await page.setViewportSize(SIZES.desk);
  await page.emulateMedia({'prefers-color-scheme': 'light'});
}
