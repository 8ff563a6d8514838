// The layout, from the boxes of the page: on a telephone, a laptop and a large screen, light and dark, in German, whose words are
// the longest. The bar has one height in every state; a run is one screen, and its end is its result.
import assert from 'node:assert/strict';
import {barriers, begin, complainsOfNothing, ENDLESS, eventually, inGerman, pictureOf, served, text} from './page_test.mjs';
import {browserName, SIZES} from './served_page.mjs';

const SCREENS = {phone: SIZES.phone, desk: SIZES.desk, wide: {width: 1920, height: 1080}};
const step = begin({pace: 100, bench: ENDLESS, enter: inGerman});
const heights = {};  // The height of the bar on each screen, as the first state sets it.

// Boxes that extend beyond the sides of the screen, buttons that are cut off, and plots with axes but no data.
const badBoxes = (page) => page.evaluate(() => {
  const seen = (element) => element.checkVisibility({visibilityProperty: true});
  const name = (element) => `${element.tagName}#${element.id}.${element.className} "${element.textContent.trim().slice(0, 30)}"`;
  const bad = document.documentElement.scrollWidth > innerWidth ? [`the page is ${document.documentElement.scrollWidth} px wide in ${innerWidth}`] : [];
  for (const element of document.querySelectorAll('main button, main .plot, main h3, main h4, #banner p, #banner dd, #do-stop')) {
    const {left, right} = element.getBoundingClientRect();
    if (seen(element) && !element.closest('.scroll-x, .scroll') && right > left && (left < -1 || right > innerWidth + 1)) bad.push(`beyond the side: ${name(element)}`);
  }
  for (const button of document.querySelectorAll('#steering button, #do-stop'))
    if (seen(button) && (button.scrollWidth > button.clientWidth + 1 || button.scrollHeight > button.clientHeight + 1)) bad.push(`cut off: ${name(button)}`);
  for (const plot of document.querySelectorAll('.plot')) {
    const isEmpty = plot.chart && !plot.chart.values.slice(1).some((column) => column.some((value) => value !== null));
    if (isEmpty && seen(plot) && seen(plot.querySelector('canvas'))) bad.push(`empty axes: ${plot.getAttribute('aria-label')}`);
  }
  return bad;
});

// Outdated values are dim on purpose: without contact their contrast is not examined.
async function eachScreen(page, state, look = async () => {}) {
  for (const [screen, viewport] of Object.entries(SCREENS)) {
    await page.setViewportSize(viewport);
    for (const scheme of browserName === 'chromium' && screen !== 'wide' ? ['light', 'dark'] : ['light']) {
      await page.emulateMedia({'prefers-color-scheme': scheme});
      await page.waitForFunction((name) => matchMedia(`(prefers-color-scheme: ${name})`).matches, scheme);
      const where = `${state}, ${screen}, ${scheme}`;
      await eventually(async () => assert.deepEqual(await badBoxes(page), [], where));
      const height = await page.evaluate(() => document.getElementById('top').offsetHeight);
      assert.equal(height, heights[screen] ??= height, `${where}: the height of the bar`);
      if (scheme === 'dark' && screen === 'desk' && state !== 'silent') await eventually(async () => assert.deepEqual(await barriers(page, ['color-contrast']), [], where));
      await look(screen, where);
    }
    await pictureOf(page, `layout-${state}-${screen}`);
  }
  await page.setViewportSize(SCREENS.desk);
  await page.emulateMedia({'prefers-color-scheme': 'light'});
}

// Elements, of those that are shown, that do not end on the first screen.
const belowScreen = (page, selectors) => page.evaluate((all) => {
  scrollTo(0, 0);
  return all.filter((one) => { const element = document.querySelector(one); return !element.checkVisibility() || element.getBoundingClientRect().bottom > innerHeight; });
}, selectors);
const becomes = (page, word) => page.waitForFunction((expected) => document.getElementById('banner-word').textContent === expected, word);

step('from an idle bench to a turning stage there are three clicks, and the last one is in sight', async (page) => {
  await page.locator('#ready-facts dd').first().waitFor();
  await eachScreen(page, 'idle');
  let clicks = 0;
  const click = async (selector) => { await page.locator(`${selector}:enabled`).click(); ++clicks; };
  await click('#take-control');
  await click('#do-start');
  await page.locator('#confirm-yes:enabled').waitFor();
  for (const viewport of Object.values(SCREENS)) {
    await page.setViewportSize(viewport);
    await eventually(async () => assert.deepEqual(await belowScreen(page, ['#confirm-yes', '#confirm-no', '#dialog-stop']), [], `${viewport.width} px`));
  }
  await page.setViewportSize(SCREENS.desk);
  await served.pressAt(48, 'do-hold');
  await click('#confirm-yes');
  assert.equal(clicks, 3);
  await page.waitForFunction(() => document.body.classList.contains('running'));
});

step('a run is one screen of a laptop: residuals large, responses small, the stage beside them', async (page) => {
  await becomes(page, 'Wartet');
  await page.waitForFunction(() => document.querySelectorAll('#residuals-now .plot:not([hidden]):not(.empty)').length === 1);
  const parts = ['#now', '#gimbal', '#x-encoder', '#run-card', '#responses', '#strip'];
  await eachScreen(page, 'held', async (screen, where) => {
    if (screen === 'phone') return;
    await eventually(async () => assert.deepEqual(await belowScreen(page, parts), [], where));
    const {main, small} = await page.evaluate(() => ({main: document.querySelector('#residuals-now .plot:not([hidden])').getBoundingClientRect().toJSON(), small: document.querySelector('#responses .plot').getBoundingClientRect().toJSON()}));
    assert.ok(main.width * main.height > 4 * small.width * small.height, `${where}: the main picture is the largest`);
  });
  assert.equal(await text('#shown-residuals'), 'Residuen von Experiment 2: X dreht, Z bei −90°');
  await page.locator('#responses button').first().click();
  await page.locator('#shown-residuals').says('Residuen von Experiment 1: X dreht');
  await page.locator('#against-time').click();
  await page.locator('#residuals-by-time').waitFor();
});

step('commands are found and pressed by keyboard, and Stop stays in reach', async (page) => {
  const press = async (...keys) => { for (const key of keys) await page.keyboard.down(key); for (const key of keys.reverse()) await page.keyboard.up(key); };
  await press('Control', 'k');
  await page.locator('#palette-list li').first().waitFor();
  assert.ok(await page.evaluate(() => {
    const {x, y, width, height} = document.getElementById('do-stop').getBoundingClientRect();
    return document.getElementById('do-stop').contains(document.elementFromPoint(x + width / 2, y + height / 2));
  }));
  assert.deepEqual(await barriers(), []);
  await page.keyboard.type('zeigen lä');
  await page.locator('#palette-list li').countIs(1);
  await press('Enter');
  await page.waitForFunction(() => location.hash === '#runs' && !document.getElementById('palette').open);
  await page.locator('#run-table table').waitFor();
  await eachScreen(page, 'runs', async (screen, where) => {
    const [wide, room] = await page.evaluate(() => { const {scrollWidth, clientWidth} = document.getElementById('run-table'); return [scrollWidth, clientWidth]; });
    assert.ok(wide <= room, `${where}: the list is ${wide} px wide in ${room}`);
  });
  await press('Control', 'k');
  await page.keyboard.type('Wandanzeige');
  await press('Enter');
  await page.waitForFunction(() => document.body.classList.contains('kiosk'));
});

step('a wall display is as high as the wall', async (page) => {
  for (const screen of ['desk', 'wide']) {
    await page.setViewportSize(SCREENS[screen]);
    await eventually(async () => {
      const {whole, filled, room} = await page.evaluate(() => ({whole: document.documentElement.scrollHeight, room: innerHeight, filled: document.getElementById('run-card').getBoundingClientRect().bottom}));
      assert.ok(whole <= room && filled > 0.95 * room, `${screen}: ${filled} and ${whole} of ${room} px`);
      assert.deepEqual(await badBoxes(page), [], screen);
    });
  }
  await page.setViewportSize(SCREENS.desk);
  await page.locator('#leave-kiosk').click();
});

step('the end of a run is its result, without a click', async (page) => {
  await served.press('#do-continue');
  await becomes(page, 'Fertig');
  await page.locator('#outcome-values table').waitFor();
  assert.equal((await text('#outcome-values')).match(/±/g).length, 1 + 9, 'nine values, and the heading');
  await page.locator('#outcome-verdict .verdict-word').says(/Brauchbar|Zweifelhaft|Unbrauchbar/);
  const points = await page.evaluate(() => document.querySelector('#outcome-figure .plot').chart.values.map((column) => column.length));
  assert.deepEqual(points, [119, 119, 119], 'each angle before and after');
  assert.deepEqual(await page.locator('#outcome-links .button, #outcome-links button').allInnerTexts(), ['Nächsten Gegenstand messen', 'Das ganze Ergebnis', 'Kalibrierschein', 'Bericht (HTML)', 'Bericht (PDF)']);
  await eachScreen(page, 'finished', async (screen, where) => {
    if (screen !== 'phone') assert.deepEqual(await belowScreen(page, ['#outcome-links', '#outcome-values', '#outcome-figure']), [], where);
  });
  await page.locator('#outcome-links a.button').first().click();
  await page.locator('#answer').waitFor();
  await eachScreen(page, 'result');
  await served.goTo('live');
});

step('a console that is silent fits into the bar', async (page) => {
  served.server.kill('SIGSTOP');
  await page.locator('#contact').says(/^Kein Kontakt seit/);
  await eachScreen(page, 'silent');
  served.server.kill('SIGCONT');
  await page.locator('#contact').says('');
});

step('a reply ends with what it began, and a stop fits into the bar', async (page) => {
  await page.locator('#take-control:enabled').waitFor();  // A long silence has ended the control of this page.
  if (/übernehmen/.test(await text('#take-control'))) await page.locator('#take-control').click();
  await page.locator('#outcome-next:enabled').click();
  await page.locator('#confirm-yes:enabled').click();
  await page.locator('#reply').says('Beginn: angenommen');
  await page.locator('#do-stop:enabled').click();
  await becomes(page, 'Unterbrochen');
  await page.locator('#halt').says(/^Achse X steht\. Achse Z steht\./);
  await page.locator('#reply').says('');
  await eachScreen(page, 'interrupted');
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
