// Makes the pictures of docs/images again, of the bench in docs/examples/simulated.toml:
//   cmake --build build/release --target console_screenshots
// An argument names a folder into which all pictures go instead, every view at every size, light and dark, for looking at.
import {mkdirSync, readFileSync} from 'node:fs';
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

// `kept` are the pictures for docs/images: [name, size, light or dark].
async function keep(name, {kept = [], whole = false} = {}) {
  const take = async (file, viewport, colorScheme, fullPage) => {
    await page.setViewportSize(viewport);
    await page.emulateMedia({'prefers-color-scheme': colorScheme});
    await page.waitForTimeout(400);  // Plots follow the size of their place.
    await page.evaluate(() => scrollTo(0, 0));
    await page.screenshot({path: path.join(folder, file), fullPage});
  };
  if (everything) {
    for (const [size, viewport] of Object.entries(SIZES))
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
await served.stateIs(/^Held/);
await page.locator('#note').fill('Door opened for a moment');
await page.locator('#note').press('Enter');
await keep('live', {kept: [['live', {width: 1366, height: 1060}, 'light'], ['phone', SIZES.phone, 'dark']], whole: true});
await served.goTo('kiosk');
await keep('wall', {kept: [['wall', SIZES.desk, 'light']]});
await page.locator('#leave-kiosk').click();
await page.locator('#do-continue').click();
await keep('asks');
await page.locator('#confirm-yes').click();
await served.stateIs(/^The run is complete/);
for (let seed = 2; seed <= 6; ++seed) {
  served.describe(benchOf(seed));
  await served.press('#do-start');
  await served.stateIs(/^(?!The run is complete)/);
  await served.stateIs(/^The run is complete/);
}
await keep('complete', {whole: true});
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
await served.close();
