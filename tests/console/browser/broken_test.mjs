// Parts of the page are missing, have a mistake, or never end loading. The page is not white and says so, and its Stop ends a run that
// moves. One whole page steers the run; each broken page is opened and closed for its case.
import assert from 'node:assert/strict';
import {readdirSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {DrivenPage} from './driven_page.mjs';
import {begin, complainsOfNothing, confirmDialog, ENDLESS, eventually, pictureOf, says, served, stateIs, text} from './page_test.mjs';
import {browserName} from './served_page.mjs';

const folder = path.join(path.dirname(fileURLToPath(import.meta.url)), '../../../app/console/page');
const OTHERS = ['login.js'];  // Belongs to the pages that ask for a login, which have no Stop.
const WORKS = /The banner and Stop work/, ARBEITET = /Die Anzeige oben und Stopp arbeiten/;
const MOVES = /^(The axes are homed|The stage turns from angle to angle)/;
const step = begin({pace: 5, bench: ENDLESS});
let run;

// Opens a page. answers(path) decides for each file: a response is sent instead of the file, with 'never' none is sent, and with
// nothing the file itself.
async function broken(answers, {german = false, view = ''} = {}) {
  const opened = await served.browser.newPage();
  if (german) await opened.evaluateOnNewDocument(() => localStorage.setItem('abcal-language', 'de'));
  else await opened.evaluateOnNewDocument(() => localStorage.removeItem('abcal-language'));
  await opened.setRequestInterception(true);
  opened.on('request', (request) => {
    const answer = answers(new URL(request.url()).pathname);
    if (answer === 'never') return;
    if (answer) request.respond(answer); else request.continue();
  });
  opened.goto(`${served.address}${view}`).catch(() => {});  // This ends late if a file never ends loading.
  const page = new DrivenPage(opened, browserName);
  await page.locator('#do-stop').waitFor();
  return page;
}

const ERROR = {status: 500, contentType: 'text/plain', body: 'no such luck'};
const module = (body) => ({status: 200, contentType: 'text/javascript; charset=utf-8', body});

async function goesOn(page) {
  run ??= await text('#run-file');
  const {ok, why} = await page.evaluate(async (name) => (await import('/stop.js')).ask({do: 'resume', run: name, confirmed: true}), run);
  assert.ok(ok, why);
  await stateIs(MOVES);
}

// Whether a person can see the banner and Stop, uncovered, and press Stop; and the words of the banner.
const seen = (page) => page.evaluate(() => {
  const inSight = (id) => {
    const {left, top, width, height} = document.getElementById(id).getBoundingClientRect();
    const hit = document.elementFromPoint(left + width / 2, top + height / 2);
    return document.getElementById(id).checkVisibility({visibilityProperty: true, opacityProperty: true}) && document.getElementById(id).contains(hit);
  };
  return {stop: inSight('do-stop'), banner: inSight('banner'), enabled: !document.getElementById('do-stop').disabled, words: document.getElementById('banner').innerText.trim()};
});

async function stops(page, where) {
  await page.locator('#do-stop:enabled').waitFor();
  const {words, ...sight} = await seen(page);
  assert.deepEqual(sight, {stop: true, banner: true, enabled: true}, where);
  assert.doesNotMatch(words, /^(No contact|Kein Kontakt|Idle|Bereit)/, where);
  await page.locator('#do-stop').click();
  await page.locator('#halt').says(/^(Axis X has halted\. Axis Z has halted\.|Achse X steht\. Achse Z steht\.)/);
  await stateIs(/^The run is interrupted/);
}

step('a run moves', async (page) => {
  await page.locator('#take-control').click();
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await stateIs(MOVES);
  await says('#run-file', /\.run$/);
});

step('each file that the page asks for is missing, one after another: Stop ends the run', async (page) => {
  const asked = new Set();
  const whole = await broken((file) => { asked.add(file.slice(1)); }, {german: true});
  await whole.waitForFunction(() => document.getElementById('link').textContent === 'Verbunden');
  await whole.close();
  const files = [...asked].filter((file) => /\.(js|css)$/.test(file) && file !== 'stop.js').sort();
  assert.deepEqual(readdirSync(folder).filter((file) => file.endsWith('.js') && ![...files, ...OTHERS, 'stop.js'].includes(file)), [], 'the page asks for all of its modules');
  const missing = (file) => broken((name) => (name === `/${file}` ? ERROR : null), {german: true});
  let next = missing(files[0]);
  for (const [i, file] of files.entries()) {
    const without = await next;
    await without.front();
    await without.locator('#failed').says(['language.js', 'de.js'].includes(file) ? WORKS : ARBEITET).catch((error) => { throw new Error(file, {cause: error}); });
    if (['app.js', 'uplot.js', 'style.css'].includes(file)) await pictureOf(without, `without-${file.replace('.', '-')}`);
    await stops(without, file);
    await without.close();
    [next] = await Promise.all([i + 1 < files.length && missing(files[i + 1]), goesOn(page)]);  // The next page is loaded meanwhile.
  }
});

step('without Stop itself the page says what to do instead', async () => {
  const without = await broken((file) => (file === '/stop.js' ? ERROR : null));
  const {banner, words} = await seen(without);
  assert.ok(banner);
  assert.match(words, /^No contact\s+Nothing is known of the bench yet\s+Skip to content\s+Use the switch on the stage/);
  await pictureOf(without, 'without-stop-js');
  await without.close();
});

step('files never come: Stop ends the run', async (page) => {
  const files = ['app.js', 'uplot.js', 'said.js', 'style.css'];
  const waiting = await Promise.all(files.map((file) => broken((name) => (name === `/${file}` ? 'never' : null))));
  for (const [i, file] of files.entries()) {
    await waiting[i].front();
    if (file !== 'style.css') await waiting[i].locator('#failed').says(WORKS);
    if (browserName === 'chromium') await waiting[i].waitForFunction(() => performance.getEntriesByName('first-paint').length > 0);
    await pictureOf(waiting[i], `waits-for-${file.replace('.', '-')}`);
    await stops(waiting[i], file);
    await waiting[i].close();
    await goesOn(page);
  }
});

// Modules with a mistake in code that is executed at different times.
const MISTAKES = {
  'when it is loaded': {'/bench.js': 'export class BenchView {} throw new Error("a mistake of this test");'},
  'in a handler of messages': {'/bench.js': 'export class BenchView { offer() {} receive() { throw new Error("a mistake of this test"); } }'},
  'in a promise': {'/print.js': 'export function readyForPaper() { Promise.reject(new Error("a mistake of this test")); }'},
  'in a handler of keys': {'/print.js': 'export function readyForPaper() { addEventListener("keydown", () => { throw new Error("a mistake of this test"); }); }'},
};
for (const [where, files] of Object.entries(MISTAKES)) {
  step(`a module has a mistake ${where}: Stop ends the run, and the banner follows it`, async (page) => {
    const without = await broken((file) => files[file] && module(files[file]));
    await without.locator('#do-stop:enabled').waitFor();
    await without.waitForFunction(() => document.getElementById('failed').textContent || !document.dispatchEvent(new KeyboardEvent('keydown', {key: 'a', bubbles: true})));
    await without.locator('#failed').says(/^Part of this page has failed \(Error: a mistake of this test\)\. Reload the page\./);
    await without.locator('#banner-word').says('Running');
    await pictureOf(without, `mistake-${where.replaceAll(' ', '-')}`);
    await stops(without, where);
    await without.locator('#banner-word').says('Idle');
    await without.close();
    await goesOn(page);
  });
}

step('addresses that cannot be decoded, or lead nowhere, show the view Live and say so', async (page) => {
  for (const [address, shown] of [['#runs/%E0%A4%A', '#runs/%E0%A4%A'], ['#%', '#%'], ['#nowhere', '#nowhere'], ['#toString', '#toString']]) {
    const there = await broken(() => null, {view: address});
    await there.locator('#unknown-address').says(`This page has no view with the address ${shown}. It shows the view Live.`);
    await there.locator('#view-live').waitFor();
    await there.waitForFunction(() => document.getElementById('link').textContent === 'Connected');
    assert.equal(await there.locator('#failed').innerText(), '');
    await there.close();
  }
  // On a page that is open already, and back.
  await page.evaluate(() => { location.hash = '#runs'; });
  await page.locator('#view-runs').waitFor();
  await page.evaluate(() => { location.hash = '#runs/%E0%A4%A'; });
  await page.locator('#view-live').waitFor();
  await page.locator('#unknown-address').waitFor();
  await served.goTo('queue');
  await page.locator('#unknown-address').becomesHidden();
  await page.locator('#view-queue').waitFor();
});

step('"Skip to content" leads to the content of the same view', async (page) => {
  await page.locator('.skip').press('Enter');
  await eventually(async () => assert.equal(await page.evaluate(() => document.activeElement.id), 'main'));
  await page.locator('#view-queue').waitFor();
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
