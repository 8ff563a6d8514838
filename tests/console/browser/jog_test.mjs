// An axis turns as long as a button is held. It halts when the button is let go, and soon after the page is frozen or closed or the
// console is cut off. The angles are those of the emulated stage, not of the page.
import assert from 'node:assert/strict';
import {until} from './driven_page.mjs';
import {BENCH, begin, confirmDialog, eventually, served, stateIs, text} from './page_test.mjs';

const SPEED = 10;  // degrees/s
const bench = BENCH.replace('port = "simulated"', 'port = "links/stage"').replace('port = "simulated"', 'port = "links/accelerometer"')
  .replaceAll('speed_deg_per_s = 60.0', `speed_deg_per_s = ${SPEED}.0`);
const SILENCE_S = 0.3;   // The bench waits so long for a sign of life,
const LATE_S = 0.5;      // and this program, the page and a loaded computer are so late at most.
process.env.XDG_STATE_HOME = served.folder;  // The log of the guard.
let ask;
const step = begin({bench, prepare: async () => { ask = await served.emulate(); }});
const angle = async () => (await ask({do: 'status'})).x.actual_deg;

async function holdUntilItTurns(page, button = '#jog-up') {
  const from = await angle();
  await page.locator(`${button}:enabled`).waitFor();
  await page.evaluate((css) => document.querySelector(css).scrollIntoView({block: 'center'}), button);
  const {x, y, width, height} = await (await page.locator(button).one('visible')).boundingBox();
  await page.mouse.move(x + width / 2, y + height / 2);
  await page.mouse.down();
  await until(async () => Math.abs(await angle() - from) > 1, {what: 'the axis to turn'});
  return Math.sign(await angle() - from);
}
// How far the axis still turns, in seconds of its speed.
async function turnsOnFor() {
  let last = await angle();
  const from = last;
  await until(async () => { const now = await angle(), stands = now === last; last = now; return stands; }, {what: 'the axis to stand'});
  return Math.abs(last - from) / SPEED;
}

step('turns to an angle, and is homed before', async (page) => {
  await page.locator('#take-control').click();
  await page.locator('#jog-up:enabled').waitFor();
  await page.locator('#jog-how').selectOption('to');
  await page.locator('#jog-by').fill('5');
  await page.locator('#do-jog').click();
  assert.match(await text('#confirm-title'), /^Turn axis X to 5 degrees\?$/);
  await confirmDialog();
  await page.getByText(/Axis X is at 5\.00\d+ degrees \(encoder\), turned by/).waitFor();
});

step('turns while the button is held, up and down, and halts when it is let go', async (page) => {
  for (const [button, sign] of [['#jog-up', 1], ['#jog-down', -1]]) {
    assert.equal(await holdUntilItTurns(page, button), sign);
    await page.mouse.up();
    const late = await turnsOnFor();
    assert.ok(late < LATE_S, `${button}: ${late} s after the release`);
    await page.locator('#state').says(/^No run is in progress/);
  }
  assert.equal((await page.locator('#log-lines .grade-problem').count()), 0);
});

step('halts when the page is frozen, and the page says that it stands', async (page) => {
  await holdUntilItTurns(page);
  const frozen = page.evaluate(() => { for (const end = performance.now() + 2500; performance.now() < end;); });
  const late = await turnsOnFor();
  assert.ok(late < SILENCE_S + LATE_S, `${late} s`);
  await frozen;
  await page.mouse.up();
  await page.locator('#state').says(/^No run is in progress/);
});

step('halts when the console is cut off', async (page) => {
  await holdUntilItTurns(page);
  served.server.kill('SIGSTOP');
  const late = await turnsOnFor();
  served.server.kill('SIGCONT');
  assert.ok(late < SILENCE_S + LATE_S, `${late} s`);
  await page.mouse.up();
  await eventually(async () => assert.equal(await text('#link'), 'Connected'));
  await page.locator('#state').says(/^No run is in progress/);
});

step('halts when the page is closed', async (page) => {
  await holdUntilItTurns(page);
  await page.page.close();
  const late = await turnsOnFor();
  assert.ok(late < SILENCE_S + LATE_S, `${late} s`);
});
