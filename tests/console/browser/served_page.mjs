// The console of a simulated bench and the page in Debian's Chromium, for tests and for pictures. Set by CMake:
//   ABCAL_PROGRAM         the program abcal
//   ABCAL_NODE_MODULES    where playwright-core is installed
import {execFileSync, spawn} from 'node:child_process';
import {existsSync, mkdtempSync, readFileSync, rmSync, writeFileSync} from 'node:fs';
import {createRequire} from 'node:module';
import {tmpdir} from 'node:os';
import path from 'node:path';

const CHROMIUM = process.env.ABCAL_CHROMIUM || '/usr/bin/chromium';
const modules = process.env.ABCAL_NODE_MODULES;

export const SIZES = {desk: {width: 1366, height: 768}, phone: {width: 390, height: 844}};
export const PATIENCE = 25_000;  // ms; a busy machine is slow, and a run takes some seconds on a fast one

// What no page can be shown without, in words; null if all is there.
export function missing() {
  if (!modules || !existsSync(path.join(modules, 'playwright-core'))) return 'playwright-core is not installed (scripts/setup --tests does that)';
  return existsSync(CHROMIUM) ? null : `there is no ${CHROMIUM}`;
}

export class ServedPage {
  constructor() {
    this.folder = mkdtempSync(path.join(tmpdir(), 'abcal-page-'));
    this.requests = [];
    this.problems = [];
  }

  // Of a bench file with this text, `abcal serve` with these further words; opens the page.
  async open(bench, ...words) {
    await this.goToConsole(bench, ...words);
    return this.entered();
  }

  // The same, whatever page comes first.
  async goToConsole(bench, ...words) {
    this.describe(bench);
    this.address = await this.serve(...words);
    const {chromium} = createRequire(path.join(modules, 'x.js'))('playwright-core');
    this.browser = await chromium.launch({executablePath: CHROMIUM, headless: true, args: ['--headless', '--no-sandbox', '--disable-gpu',
      '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync']});
    this.page = this.watch(await this.browser.newPage({viewport: SIZES.desk, acceptDownloads: true, ignoreHTTPSErrors: true}));
    await this.page.goto(this.address);
  }

  async entered() {
    await this.page.waitForFunction(() => document.getElementById('link')?.textContent === 'Connected');
    return this.page;
  }

  // The console reads the bench file again for each run.
  describe(bench) { writeFileSync(path.join(this.folder, 'bench.toml'), bench); }

  // Again on the same port, e.g. after it was killed.
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

  watch(opened) {
    opened.setDefaultTimeout(PATIENCE);
    opened.on('request', (request) => this.requests.push(request.url()));
    opened.on('pageerror', (error) => this.problems.push(String(error)));
    opened.on('console', (message) => { if (['error', 'warning'].includes(message.type())) this.problems.push(message.text()); });
    return opened;
  }

  abcal(...words) {
    return execFileSync(process.env.ABCAL_PROGRAM, words, {cwd: this.folder, encoding: 'utf8', stdio: ['ignore', 'pipe', 'ignore'], timeout: PATIENCE});
  }

  text(selector) { return this.page.locator(selector).innerText(); }
  async measured() { return Number((await this.text('#measured')).split(' ')[0]); }
  measuredAtLeast(n, page = this.page) {
    return page.waitForFunction((least) => Number(document.getElementById('measured').textContent.split(' ')[0]) >= least, n, {timeout: PATIENCE});
  }
  // Presses a button when so many angles are measured; in the page, for a busy machine may be slow to ask it from here.
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

  // Presses a button that asks first, and says yes.
  async press(button) {
    await this.page.locator(`${button}:enabled`).click();
    await this.page.locator('#confirm-yes').click();
  }
  goTo(view) { return this.page.locator(`nav a[href="#${view}"]`).click(); }

  // At once, for a test that takes too long; the browser ends with this process.
  kill() {
    this.server?.kill('SIGKILL');
    try { process.kill(this.holder(), 'SIGKILL'); } catch { /* It has ended. */ }
    rmSync(this.folder, {recursive: true, force: true});
  }

  async close() {
    await this.browser?.close();
    this.server?.kill('SIGINT');
    rmSync(this.folder, {recursive: true, force: true});
  }
}
