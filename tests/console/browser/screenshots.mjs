// Makes the pictures of docs/images again, of the bench in docs/examples/simulated.toml:
//   cmake --build build/release --target console_screenshots
// An argument names a folder into which all pictures go instead, every view on every screen, light and dark, and a sheet of them all,
// sheet.html, for looking at; ABCAL_LANGUAGE=de: in German. The sheet names the fonts with which they were drawn: other fonts need other room.
import {mkdirSync, readFileSync, writeFileSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {missing, ServedPage, SIZES} from './served_page.mjs';

if (missing()) throw new Error(`no pictures: ${missing()}`);
const root = path.join(path.dirname(fileURLToPath(import.meta.url)), '../../..');
const everything = process.argv[2];
const folder = everything || path.join(root, 'docs/images');
const example = readFileSync(path.join(root, 'docs/examples/simulated.toml'), 'utf8').replace('6284.123456', '6284-0417').replace('rate_hz = 100.0', 'rate_hz = 100.0\nserial_number = "6284-0417"');
const benchOf = (seed) => example.replace(/^seed = .*$/m, `seed = ${seed}`);

mkdirSync(folder, {recursive: true});
const served = new ServedPage();
process.on('exit', () => served.server?.kill('SIGINT'));  // Also after an error.
const page = await served.open(benchOf(1), '--pace', '400');
const german = process.env.ABCAL_LANGUAGE === 'de';
if (german) {
  await page.locator('#language').click();
  await page.waitForFunction(() => document.documentElement.lang === 'de' && document.getElementById('link').textContent === 'Verbunden');
}
const word = {held: german ? /^Wartet$/ : /^Held$/, finished: german ? /^Fertig$/ : /^Finished$/};
const SCREENS = {desk: SIZES.desk, phone: SIZES.phone, wide: {width: 1920, height: 1080}};
const taken = [];  // The pictures of the sheet.

// The fonts with which the browser has drawn the words of these elements, by their names.
async function fontsOf(selectors) {
  const session = await page.page.createCDPSession(), names = new Set();
  await session.send('DOM.enable');
  await session.send('CSS.enable');
  const {root: {nodeId: document}} = await session.send('DOM.getDocument');
  for (const selector of selectors) {
    const {nodeId} = await session.send('DOM.querySelector', {nodeId: document, selector});
    for (const {familyName} of (await session.send('CSS.getPlatformFontsForNode', {nodeId})).fonts) names.add(familyName);
  }
  return [...names];
}

// `kept` are the pictures for docs/images: [name, size, light or dark].
async function keep(name, {kept = [], whole = false} = {}) {
  const take = async (file, viewport, colorScheme, fullPage) => {
    await page.setViewportSize(viewport);
    await page.emulateMedia({'prefers-color-scheme': colorScheme});
    await page.waitForTimeout(400);  // Plots follow the size of their place.
    await page.evaluate(() => scrollTo(0, 0));
    await page.screenshot({path: path.join(folder, file), fullPage});
    if (everything) taken.push(file);
  };
  if (everything) {
    for (const [size, viewport] of Object.entries(SCREENS))
      for (const colorScheme of ['light', 'dark']) await take(`${name}-${size}-${colorScheme}.png`, viewport, colorScheme, whole);
  } else {
    for (const [picture, viewport, colorScheme] of kept) await take(`console-${picture}.png`, viewport, colorScheme, false);
  }
  await page.setViewportSize(SIZES.desk);
  await page.emulateMedia({'prefers-color-scheme': 'light'});
}

await page.locator('#ready-facts dd').first().waitFor();
await keep('idle');
await page.locator('#take-control').click();
await served.press('#do-check');
await page.locator('#checks table').waitFor();
await page.waitForTimeout(1500);  // Readiness is read again.
await keep('checked', {kept: [['ready', SIZES.desk, 'light']], whole: true});
await served.press('#do-start');
await served.pressAt(100, 'do-hold');  // Long before the end of the run, as a busy machine is late.
await page.locator('#banner-word').says(word.held);
await page.locator('#note').fill('Door opened for a moment');
await page.locator('#note').press('Enter');
await keep('live', {kept: [['live', SIZES.desk, 'light'], ['phone', SIZES.phone, 'dark']], whole: true});
await served.goTo('kiosk');
await keep('wall', {kept: [['wall', SIZES.desk, 'light']]});
await page.locator('#leave-kiosk').click();
await page.locator('#do-continue').click();
await keep('asks');
await page.locator('#confirm-yes').click();
await page.locator('#banner-word').says(word.finished);
for (let seed = 2; seed <= 6; ++seed) {
  served.describe(benchOf(seed));
  const run = await page.evaluate(() => document.getElementById('run-file').textContent);
  await served.press('#do-start');
  await page.waitForFunction((before) => document.getElementById('run-file').textContent !== before, run);
  await page.locator('#banner-word').says(word.finished);
}
await page.locator('#outcome-figure .plot').waitFor();
await page.waitForTimeout(1500);  // Readiness is read again.
await keep('finished', {kept: [['finished', SIZES.desk, 'light']], whole: true});
await served.goTo('runs');
await page.locator('#run-table table').waitFor();
await keep('runs');
await page.locator('#run-table tbody a').first().click();
await page.locator('#estimators').waitFor();
await page.waitForFunction(() => document.querySelector('#residuals .plot')?.chart.values[0].length > 10);
await keep('result', {kept: [['result', {width: 1366, height: 900}, 'light']], whole: true});
// The residuals with the pointer on a point, whose readings are shown.
await page.setViewportSize({width: 1366, height: 1100});
const toResiduals = () => page.evaluate(() => scrollTo(0, document.getElementById('residuals').getBoundingClientRect().top + scrollY - 230));
await toResiduals();
const {x, y, width} = await (await page.locator('#residuals .plot').first().one('visible')).boundingBox();
await page.mouse.click(x + width / 2, y + 90);
await page.locator('#angle-readings .plot').waitFor();
await page.waitForTimeout(400);
await toResiduals();
await page.mouse.move(x + width / 2 + 4, y + 90);
await page.waitForTimeout(300);
await page.screenshot({path: path.join(folder, everything ? 'residuals.png' : 'console-residuals.png')});
await served.goTo('compare');
await page.locator('#compare-form button').click();
await page.locator('#compare-words').waitFor();
await keep('compare', {whole: true});
await served.goTo('chart');
await page.locator('#chart-words').waitFor();
await keep('chart', {kept: [['chart', SIZES.desk, 'light']], whole: true});
if (everything) {
  await served.goTo('live');
  await served.press('#do-start');
  await page.locator('#do-stop:enabled').click();
  await page.locator('#interrupted').waitFor();
  await keep('interrupted');
  await served.goTo('queue');
  await page.locator('#queue-add').waitFor();
  await keep('queue');
  await served.goTo('bench');
  await keep('bench');
  const fonts = await fontsOf(['body', 'code', '#banner-word']);
  const figure = (file) => `<figure><a href="${file}"><img src="${file}" loading="lazy"></a><figcaption>${file}</figcaption></figure>`;
  writeFileSync(path.join(folder, 'sheet.html'), `<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>Views of the console</title>
<style>body { font: 14px sans-serif } main { columns: 22rem } figure { break-inside: avoid; margin: 0 0 1rem } img { width: 100%; border: 1px solid #888 }</style>
<h1>Views of the console, ${german ? 'German' : 'English'}</h1><p>Fonts: ${fonts.join('; ')}. Browser: ${await served.browser.version()}.</p><main>${taken.map(figure).join('')}</main></html>\n`);
  console.log(`${taken.length} pictures with ${fonts.join('; ')}: ${path.join(folder, 'sheet.html')}`);
}
await served.close();
