// The console of a simulated bench and the page in Debian's Chromium or Firefox, for tests and for pictures. Set by CMake:
//   ABCAL_PROGRAM         the program abcal
//   ABCAL_NODE_MODULES    where puppeteer-core is installed
//   ABCAL_BROWSER         chromium (default) or firefox
// Set by hand, to find missing waits of a test:
//   ABCAL_THROTTLE        e.g. 6: the page works 6 times slower, and its messages are late
import {execFileSync, spawn} from 'node:child_process';
import {existsSync, mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync, writeFileSync} from 'node:fs';
import {createRequire} from 'node:module';
import {connect} from 'node:net';
import {tmpdir} from 'node:os';
import path from 'node:path';
import {DrivenPage, PATIENCE, slowDown, until} from './driven_page.mjs';

export const browserName = process.env.ABCAL_BROWSER || 'chromium';
const PROGRAM = {chromium: process.env.ABCAL_CHROMIUM || '/usr/bin/chromium', firefox: process.env.ABCAL_FIREFOX || '/usr/bin/firefox-esr'}[browserName];
const OPTIONS = {
  chromium: {browser: 'chrome', args: ['--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking',
    '--disable-component-update', '--disable-sync', '--lang=en-GB']},
  // Nothing is fetched from elsewhere.
  firefox: {browser: 'firefox'},
}[browserName];
// Preferences of Firefox: a folder for downloads, and no requests of its own.
const preferences = (downloads) => ({'intl.accept_languages': 'en-GB, en', 'network.captive-portal-service.enabled': false,
  'network.connectivity-service.enabled': false, 'browser.download.folderList': 2, 'browser.download.dir': downloads,
  'browser.download.useDownloadDir': true, 'browser.download.alwaysOpenPanel': false});
const modules = process.env.ABCAL_NODE_MODULES;
// A module that scripts/setup --tests has installed.
export const fromRegistry = createRequire(path.join(modules || '.', 'x.js'));

// zoomed: a desk at 200 %; narrow: a desk of 1280 px at 400 %.
export const SIZES = {desk: {width: 1366, height: 768}, phone: {width: 390, height: 844}, zoomed: {width: 683, height: 384}, narrow: {width: 320, height: 568}};
export {PATIENCE};

// The first missing requirement for showing a page, in words; null if all are met.
export function missing() {
  if (!modules || !existsSync(path.join(modules, 'puppeteer-core'))) return 'puppeteer-core is not installed (scripts/setup --tests does that)';
  return existsSync(PROGRAM) ? null : `there is no ${PROGRAM} (scripts/setup --tests installs it)`;
}

export class ServedPage {
  constructor() {
    this.folder = mkdtempSync(path.join(tmpdir(), 'abcal-page-'));
    this.requests = [];
    this.problems = [];
  }

  // Serves a bench file with this text by `abcal serve` with further words, and opens the page.
  async open(bench, ...words) {
    await this.goToConsole(bench, ...words);
    return this.entered();
  }

  // The same, but stops at the first page, e.g. the login page.
  async goToConsole(bench, ...words) {
    this.describe(bench);
    this.address = await this.serve(...words);
    this.downloads = path.join(this.folder, 'downloads');
    mkdirSync(this.downloads);
    this.browser = await fromRegistry('puppeteer-core').launch({...OPTIONS, executablePath: PROGRAM, headless: true, acceptInsecureCerts: true,
      defaultViewport: SIZES.desk, ...(browserName === 'firefox' ? {extraPrefsFirefox: preferences(this.downloads)}
        : {downloadBehavior: {policy: 'allow', downloadPath: this.downloads}})});
    this.page = await this.newPage();
    await this.page.goto(this.address);
  }

  async entered() {
    await this.page.waitForFunction(() => document.getElementById('link')?.textContent === 'Connected');
    return this.page;
  }

  // The console reads the bench file again for each run.
  describe(bench) { writeFileSync(path.join(this.folder, 'bench.toml'), bench); }

  // Serves again on the same port, e.g. after the console was killed.
  serveAgain(...words) { return this.serve('--port', new URL(this.address).port, ...words); }

  // The process that holds the bench, which the console has started.
  holder() { return Number(readFileSync(path.join(this.folder, '.bench.bench.lock'), 'utf8')); }

  serve(...words) {
    const port = words.includes('--port') ? [] : ['--port', '0'];
    this.server = spawn(process.env.ABCAL_PROGRAM, ['serve', 'bench.toml', ...port, ...words], {cwd: this.folder, stdio: ['ignore', 'pipe', 'inherit']});
    return new Promise((resolve, reject) => {
      let said = '';
      this.server.stdout.on('data', (bytes) => {
        said += bytes;
        const found = said.match(/Console: (https?:\S+)/);
        if (found) resolve(found[1]);
      });
      this.server.on('exit', (code) => reject(new Error(`abcal serve ended with ${code}`)));
    });
  }

  // Another page of this visitor, or of one who is not known yet.
  async newPage() {
    const opened = await this.browser.newPage();
    await opened.bringToFront();
    return this.watch(opened);
  }
  async newVisitor() { return this.watch(await (await this.browser.createBrowserContext()).newPage()); }

  async watch(opened) {
    if (process.env.ABCAL_THROTTLE) await slowDown(opened, browserName, Number(process.env.ABCAL_THROTTLE));
    opened.on('request', (request) => this.requests.push(request.url()));
    opened.on('pageerror', (error) => this.problems.push(String(error)));
    opened.on('console', (message) => { if (['error', 'warn'].includes(message.type())) this.problems.push(message.text()); });
    return new DrivenPage(opened, browserName);
  }

  abcal(...words) {
    return execFileSync(process.env.ABCAL_PROGRAM, words, {cwd: this.folder, encoding: 'utf8', stdio: ['ignore', 'pipe', 'ignore'], timeout: PATIENCE});
  }

  // Calls `does`, which downloads a file; returns the path of the complete file.
  async download(does) {
    const before = new Set(readdirSync(this.downloads));
    await does();
    for (const end = performance.now() + PATIENCE; performance.now() < end; await this.page.waitForTimeout(30)) {
      const now = readdirSync(this.downloads).filter((name) => !before.has(name));
      if (now.length && !now.some((name) => /\.(crdownload|part)$|^\.org\.chromium/.test(name))) return path.join(this.downloads, now[0]);
    }
    throw new Error('no file was downloaded');
  }

  // The text of the printed page.
  async print() {
    const file = path.join(this.folder, 'printed.pdf');
    await this.page.page.pdf({path: file, format: 'A4', preferCSSPageSize: true, printBackground: true});
    return execFileSync('pdftotext', ['-layout', file, '-'], {encoding: 'utf8'});
  }

  text(selector) { return this.page.locator(selector).innerText(); }
  async measured() { return Number((await this.text('#measured')).split(' ')[0]); }
  // Records all texts of an element from now on; returns a function that reads them.
  async recorded(id) {
    await this.page.evaluate((name) => {
      const element = document.getElementById(name), texts = [];
      new MutationObserver(() => texts.push(element.textContent)).observe(element, {childList: true, characterData: true, subtree: true});
      (globalThis.recorded ??= {})[name] = texts;
    }, id);
    return () => this.page.evaluate((name) => globalThis.recorded[name], id);
  }
  measuredAtLeast(n, page = this.page) {
    return page.waitForFunction((least) => Number(document.getElementById('measured').textContent.split(' ')[0]) >= least, n, {timeout: PATIENCE});
  }
  // Presses a button when `n` angles are measured. Runs in the page, as polling from here may be slow on a busy machine.
  pressAt(n, button) {
    return this.page.evaluate(([least, id]) => {
      const measured = document.getElementById('measured'), pressed = document.getElementById(id);
      new MutationObserver((_, observer) => {
        if (pressed.disabled || Number(measured.textContent.split(' ')[0]) < least) return;
        observer.disconnect();
        pressed.click();
      }).observe(measured, {childList: true});
    }, [n, button]);
  }
  stateIs(pattern) {
    return this.page.waitForFunction((source) => new RegExp(source).test(document.getElementById('state').textContent), pattern.source, {timeout: PATIENCE});
  }

  // Presses a button that opens a confirmation, and confirms.
  async press(button) {
    await this.page.locator(`${button}:enabled`).click();
    await this.page.locator('#confirm-yes').click();
  }
  goTo(view) { return this.page.locator(`nav a[href="#${view}"]`).click(); }

  // Emulates instruments on pseudo-terminals in the folder `links`, in real time. Returns a function that sends a request to them.
  async emulate(names = ['stage', 'accelerometer']) {
    this.emulator = spawn(process.env.ABCAL_PROGRAM, ['emulate', 'bench.toml', '--link-dir', 'links', '--control', '0'], {cwd: this.folder, stdio: ['ignore', 'pipe', 'ignore']});
    let said = '';
    this.emulator.stdout.on('data', (bytes) => { said += bytes; });
    const port = await until(() => said.match(/control: tcp:127\.0\.0\.1:(\d+)/)?.[1], {what: 'the emulated instruments'});
    await until(() => names.every((name) => existsSync(path.join(this.folder, 'links', name))), {what: 'the links to them'});
    return (request) => new Promise((resolve, reject) => {
      const socket = connect(Number(port), '127.0.0.1', () => socket.write(`${JSON.stringify(request)}\n`));
      socket.once('error', reject);
      socket.once('data', (reply) => {
        socket.end();
        const answer = JSON.parse(reply);
        if (answer.ok) resolve(answer); else reject(new Error(String(reply)));
      });
    });
  }

  // Ends everything at once, for a test that takes too long; the browser ends with this process.
  kill() {
    this.server?.kill('SIGKILL');
    this.emulator?.kill('SIGKILL');
    try { process.kill(this.holder(), 'SIGKILL'); } catch { /* It has ended. */ }
    this.remove();
  }

  async close() {
    await this.browser?.close();
    const ended = [this.server, this.emulator].filter((each) => each && each.exitCode === null && each.signalCode === null)
      .map((each) => new Promise((resolve) => { each.once('exit', resolve); each.kill('SIGINT'); }));
    await Promise.all(ended);
    this.remove();
  }

  // The guard of a stage and the browser may still write into the folder while they end.
  remove() { rmSync(this.folder, {recursive: true, force: true, maxRetries: 20, retryDelay: 100}); }
}
