// A page of a browser that puppeteer-core drives. Conditions are polled from here, up to PATIENCE: puppeteer's own waiting puts a
// function into the page as text, which the console's policy forbids.
import assert from 'node:assert/strict';

// ms; a busy machine is slow, and a run takes some seconds on a fast one, but minutes in real time.
export const PATIENCE = 1000 * Number(process.env.ABCAL_PATIENCE_S || 25);

// ms; a click without an event by then has hit a disabled element.
const HEARD_WITHIN = 2000;

const pause = (ms) => new Promise((resolve) => setTimeout(resolve, ms));

// Polls `look`, and returns its first true result.
export async function until(look, {timeout = PATIENCE, what = 'it'} = {}) {
  const end = performance.now() + timeout;
  for (;;) {
    let problem = '';
    try {
      const seen = await look();
      if (seen) return seen;
    } catch (error) {  // For example, the page was loaded again meanwhile.
      problem = `: ${error.message}`;
    }
    if (performance.now() > end) throw new Error(`waited ${timeout} ms in vain for ${what}${problem}`);
    await pause(30);
  }
}

// Repeats an assertion until it does not throw: for changes of the page shortly after a click, a key or a message.
export async function eventually(assertion) {
  for (const end = performance.now() + PATIENCE;; await pause(30)) {
    try {
      return await assertion();
    } catch (error) {
      if (performance.now() > end) throw error;
    }
  }
}

// Runs in the page: all elements that the steps lead to.
function found(steps) {
  let all = [document];
  for (const {css, text, pattern, without, exact, innermost, first} of steps) {
    if (css) all = [...new Set(all.flatMap((root) => [...root.querySelectorAll(css)]))];
    if (text !== undefined || pattern) {
      const says = (element) => {
        const said = element.textContent.replace(/\s+/g, ' ').trim();
        return pattern ? new RegExp(pattern).test(said) : exact ? said === text : said.includes(text);
      };
      all = all.filter((element) => says(element) && !(innermost && [...element.children].some(says)));
    }
    if (without !== undefined) all = all.filter((element) => !element.textContent.includes(without));
    if (first) all = all.slice(0, 1);
  }
  return all;
}

const words = (text) => (text instanceof RegExp ? {pattern: text.source} : text === undefined ? {} : {text});
const STATES = {
  attached: () => true,
  visible: (element) => element.checkVisibility({visibilityProperty: true}),
  usable: (element) => element.checkVisibility({visibilityProperty: true}) && !element.matches(':disabled'),
  reachable: (element) => {
    element.scrollIntoView({block: 'center', behavior: 'instant'});
    const {x, y, width, height} = element.getClientRects()[0];  // The box of its first line.
    return element.contains(document.elementFromPoint(x + width / 2, y + height / 2));
  },
};

// Elements by selector and text. Functions for a single element use the first one.
class Elements {
  constructor(page, steps) {
    this.page = page;
    this.steps = steps;
  }

  locator(css, {hasText, hasNotText} = {}) { return new Elements(this.page, [...this.steps, {css, without: hasNotText, ...words(hasText)}]); }
  first() { return new Elements(this.page, [...this.steps, {first: true}]); }
  evaluateAll(does) { return this.page.evaluateHandle(found, this.steps).then((all) => all.evaluate(does)); }
  count() { return this.evaluateAll((all) => all.length); }
  allInnerTexts() { return this.evaluateAll((all) => all.map((element) => element.innerText)); }
  isVisible() { return this.evaluateAll((all) => all.some((element) => element.checkVisibility({visibilityProperty: true}))); }
  async isHidden() { return !(await this.isVisible()); }
  async isDisabled() { return (await this.one('attached')).evaluate((element) => element.disabled); }
  async isEnabled() { return !(await this.isDisabled()); }
  async innerText() { return (await this.one('attached')).evaluate((element) => element.innerText); }
  async inputValue() { return (await this.one('attached')).evaluate((element) => element.value); }
  waitFor() { return this.one('visible'); }
  becomesHidden() { return until(() => this.isHidden(), {what: `${JSON.stringify(this.steps)} to be hidden`}); }
  becomesDisabled() { return until(() => this.isDisabled(), {what: `${JSON.stringify(this.steps)} to be disabled`}); }
  becomesEnabled() { return this.one('usable'); }
  countIs(n) { return eventually(async () => assert.equal(await this.count(), n, JSON.stringify(this.steps))); }
  // Waits for a text: all of it as a string, or a pattern.
  says(words) {
    return eventually(async () => {
      const said = await this.innerText();
      if (words instanceof RegExp) assert.match(said, words, JSON.stringify(this.steps));
      else assert.equal(said, words, JSON.stringify(this.steps));
    });
  }

  one(state) {
    return until(async () => {
      for (const property of (await (await this.page.evaluateHandle(found, this.steps)).getProperties()).values()) {
        const element = property.asElement();
        if (element && await element.evaluate(STATES[state])) return element;
      }
      return null;
    }, {what: `${JSON.stringify(this.steps)} to be ${state}`});
  }

  // Finds the element again if it was replaced before the click, as the rows of a list are; clicks again if it was disabled at that
  // moment, as a button is while the form is checked. If its page is gone, the click was effective. (Firefox still evaluates in the
  // new page, where clickHeard is undefined and not false.)
  click(options) {
    return until(async () => {
      const element = await this.one('usable');
      if (!await element.evaluate(STATES.reachable)) return false;
      // On the document, as the pressed element may be replaced at that moment, as the rows of a list are.
      await element.evaluate(() => {
        globalThis.clickHeard = false;
        document.addEventListener('click', () => { globalThis.clickHeard = true; }, {capture: true, once: true});
      });
      await element.click(options);
      return await until(() => element.evaluate(() => globalThis.clickHeard !== false).catch(() => true), {timeout: HEARD_WITHIN, what: 'the click'}).catch(() => false);
    }, {what: `${JSON.stringify(this.steps)} to be in nobody's shade`});
  }
  dblclick() { return this.click({count: 2}); }
  async check() { if (!(await (await this.one('usable')).evaluate((element) => element.checked))) await this.click(); }
  async fill(value) {
    await (await this.one('usable')).evaluate((element, text) => {
      element.focus();
      element.value = text;
      for (const kind of ['input', 'change']) element.dispatchEvent(new Event(kind, {bubbles: true}));
    }, value);
  }
  async choose(file) { await (await this.one('usable')).uploadFile(file); }
  async press(key) { await (await this.one('usable')).press(key); }
  async selectOption(value) { await (await this.one('usable')).select(value); }
}

// A slow computer and a slow line: the page's work takes `times` as long, and messages and changes of the view are late. Runs in
// the page before its scripts. (In Firefox messages are late, but the work takes as long as usual.)
function late(times) {
  const wait = () => 40 * times * Math.random();
  let last = 0;  // The delayed messages keep their order.
  const queued = (does) => {
    last = Math.max(last, performance.now() + wait());
    setTimeout(does, last - performance.now());
  };
  globalThis.WebSocket = class extends WebSocket {
    set onmessage(does) { super.onmessage = (event) => queued(() => { if (this.readyState === WebSocket.OPEN) does(event); }); }
  };
  const ask = globalThis.fetch;
  globalThis.fetch = async (...words) => { const response = await ask(...words); await new Promise((done) => setTimeout(done, wait())); return response; };
  const listen = globalThis.addEventListener;
  globalThis.addEventListener = (kind, does, ...more) => listen(kind, kind === 'hashchange' ? (event) => setTimeout(() => does(event), wait()) : does, ...more);
}

export async function slowDown(page, browserName, times) {
  if (browserName === 'chromium') await page.emulateCPUThrottling(times);
  await page.evaluateOnNewDocument(late, times);
}

const ROLES = {button: 'button', link: 'a[href]'};

export class DrivenPage {
  constructor(page, browserName) {
    this.page = page;
    this.browserName = browserName;
    this.keyboard = page.keyboard;
    this.mouse = page.mouse;
  }

  locator(css, {hasText, hasNotText} = {}) { return new Elements(this.page, [{css, without: hasNotText, ...words(hasText)}]); }
  getByText(text) { return new Elements(this.page, [{css: 'body *:not(script)', ...words(text), innermost: true}]); }
  getByRole(role, {name}) { return new Elements(this.page, [{css: ROLES[role], ...words(name), exact: true}]); }
  waitForFunction(does, argument, options) { return until(() => this.page.evaluate(does, argument), {what: String(does), ...options}); }
  waitForTimeout(ms) { return pause(ms); }

  evaluate(...all) { return this.page.evaluate(...all); }
  goto(address) { return this.page.goto(address, {timeout: PATIENCE}); }
  reload() { return this.page.reload({timeout: PATIENCE}); }
  url() { return this.page.url(); }
  title() { return this.page.title(); }
  front() { return this.page.bringToFront(); }
  close() { return this.page.close(); }
  screenshot(options) { return this.page.screenshot(options); }
  cookies() { return this.page.browserContext().cookies(); }
  setOffline(offline) { return this.page.setOfflineMode(offline); }
  // Firefox 140 (Debian 13) has no screen orientation, which puppeteer-core sets together with the size.
  async setViewportSize(size) {
    await this.page.setViewport(size).catch((error) => { if (!/unknown command emulation.setScreenOrientationOverride/.test(error.message)) throw error; });
    await eventually(async () => assert.equal(await this.page.evaluate(() => innerWidth), size.width));
  }
  // For example {'prefers-color-scheme': 'dark'}; puppeteer-core cannot set this in Firefox.
  async emulateMedia(features) {
    if (this.browserName === 'chromium') await this.page.emulateMediaFeatures(Object.entries(features).map(([name, value]) => ({name, value})));
  }
}
