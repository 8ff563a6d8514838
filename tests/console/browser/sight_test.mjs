// Things seen first, and from afar: the first datum is within the first quarter of every screen, the banner is steady, the wall
// display is large, and high contrast loses nothing.
import assert from 'node:assert/strict';
import {SIZES} from './served_page.mjs';
import {abcal, begin, complainsOfNothing, confirmDialog, contrastPictures, ENDLESS, eventually, firstDatum, pictureOf, served, stateIs, text} from './page_test.mjs';

const step = begin({pace: 5, bench: ENDLESS, serve: ['--tiles', '.'], prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});

async function firstQuarter(page, view) {
  for (const size of ['desk', 'phone']) {
    await page.setViewportSize(SIZES[size]);
    await eventually(async () => {
      await page.evaluate(() => scrollTo(0, 0));
      const first = await firstDatum(page);
      assert.ok(first && first.at <= 0.25, `${view}, ${size}: ${JSON.stringify(first)}`);
    });
    console.log(`${view}, ${size}: first datum at ${Math.round(100 * (await firstDatum(page)).at)} % of the height`);
  }
  await page.setViewportSize(SIZES.desk);
}

step('at rest: readiness, runs and results begin in the first quarter of the screen', async (page) => {
  await page.locator('#ready-facts dd').first().waitFor();
  await firstQuarter(page, 'live');
  await page.goto(`${served.address}#runs`);
  await page.locator('#run-table td').first().waitFor();
  await firstQuarter(page, 'runs');
  await page.goto(`${served.address}#runs/first.run`);
  await page.locator('#estimators').waitFor();
  await firstQuarter(page, 'a result');
  await served.goTo('live');
});

step('one button is the next step, and those that cannot be used say why', async (page) => {
  const next = () => page.evaluate(() => [...document.querySelectorAll('.next-step')].map(({id}) => id));
  await eventually(async () => assert.deepEqual(await next(), ['take-control']));
  await page.locator('#who-steers').says('The other buttons need control.');
  await page.locator('#take-control').click();
  await eventually(async () => assert.deepEqual(await next(), ['do-check']));  // This bench has not been checked.
  await page.locator('#next-step').says('Next step: Check');
  await page.locator('#who-steers').says('');
  await page.locator('#do-check').click();
  await confirmDialog();
  await eventually(async () => assert.deepEqual(await next(), ['do-start']));
});

step('during a run the banner changes with the state, not with each phase', async (page) => {
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await page.locator('#banner-word').says('Measuring');
  const records = {};
  for (const id of ['banner-word', 'state', 'phase']) records[id] = await served.recorded(id);
  const before = await served.measured();
  await served.measuredAtLeast(before + 4);
  assert.deepEqual(await records['banner-word'](), []);
  assert.deepEqual(await records.state(), []);
  assert.ok((await records.phase()).length >= 8, 'and the phases are shown');
  await page.locator('#do-hold:enabled').click();
  await stateIs(/^Held/);
  assert.equal(await text('#item'), 'SN 0417');
  for (const view of ['live', 'queue', 'bench', 'runs', 'benches', 'compare', 'chart']) {
    await served.goTo(view);
    await firstQuarter(page, view);
  }
});

step('the bench is a tile among those of this computer', async (page) => {
  await served.goTo('benches');
  await page.locator('.bench-tile', {hasText: /^bench.*Held.*SN 0417.*\d+ of 119/}).waitFor();
  await pictureOf(page, 'benches');
});

step('on a wall progress and time left are half as high as the word', async (page) => {
  await served.goTo('kiosk');
  for (const viewport of [SIZES.desk, {width: 1920, height: 1080}]) {
    await page.setViewportSize(viewport);
    await eventually(async () => {
      const [word, measured, left] = await page.evaluate(() => ['banner-word', 'measured', 'left'].map((id) => parseFloat(getComputedStyle(document.getElementById(id)).fontSize)));
      assert.ok(Math.abs(measured / word - 0.5) < 0.02 && Math.abs(left / word - 0.5) < 0.02, `${word}, ${measured}, ${left} px`);
    });
  }
  await pictureOf(page, 'wall');
  await page.setViewportSize(SIZES.desk);
  await page.locator('#leave-kiosk').click();
});

step('in high contrast and with reduced motion nothing is lost', async (page) => {
  await contrastPictures('held', async () => {
    const colours = await page.evaluate(() => {
      const of = (selector, name) => getComputedStyle(document.querySelector(selector))[name];
      return {icon: of('#banner-icon', 'stroke'), word: of('#banner-word', 'color'), back: of('#banner', 'backgroundColor'), edge: of('#banner', 'borderTopWidth'), moving: document.getAnimations().length};
    });
    assert.equal(colours.icon, colours.word);
    assert.notEqual(colours.icon, colours.back);
    assert.equal(colours.edge, '3px');
    assert.equal(colours.moving, 0);
    await eventually(async () => assert.equal(await page.evaluate(() => document.getElementById('strip').chart.plot.series[1]._stroke), 'CanvasText'));
  });
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
