// Two pages of one bench; stopping and resuming a run.
import assert from 'node:assert/strict';
import {ANGLES, begin, complainsOfNothing, confirmDialog, eventually, measured, says, served, stateIs, text} from './page_test.mjs';

const step = begin({pace: 10});
let runName;

step('starts a run, and holds it', async (page) => {
  await page.getByRole('button', {name: 'Take control'}).click();
  await page.locator('#do-start:enabled').click();
  await confirmDialog();
  await served.pressAt(8, 'do-hold');
  await stateIs(/^Held/);
  runName = await text('#run-file');
});

step('another page watches, and steers only after it took control', async (page) => {
  const other = await served.newPage();
  await other.goto(served.address);
  await served.measuredAtLeast(8, other);
  await other.locator('#do-stop').becomesEnabled();  // A page that only watches may stop.
  assert.ok(await other.locator('#do-continue').isDisabled());
  await other.locator('#who-steers').says(/^page \d+ at 127\.0\.0\.1:\d+ steers\.$/);
  await other.getByRole('button', {name: 'Take control from the other page'}).click();
  await other.locator('#confirm-yes').click();
  await other.locator('#do-continue:enabled').waitFor();
  // The page that lost control names the page that has taken it.
  await page.getByText(/This page no longer has control: page \d+ at 127\.0\.0\.1:\d+ has taken it/).waitFor();
  await page.locator('#do-continue').becomesDisabled();
  await other.close();
  // Waits until the console has noticed that nobody steers: before, the button opens a dialog that nobody answers.
  await page.getByRole('button', {name: 'Take control'}).click();
  await page.locator('#do-continue:enabled').waitFor();
});

step('a page asks for control, and the page that steers hands it over', async (page) => {
  const other = await served.newPage();
  await other.goto(served.address);
  await page.locator('#who-watches').says(/^Also on this bench: page \d+ at 127\.0\.0\.1:\d+\.$/);
  for (const answer of ['#not-now', '#hand-over']) {
    await other.page.bringToFront();
    await other.locator('#ask-control:enabled').click();
    await other.locator('#ask-control').says('Asked for control');
    await page.locator('#asks-words').says(/^page \d+ at 127\.0\.0\.1:\d+ asks for control\.$/);
    await page.page.bringToFront();
    await page.locator(answer).click();
    await page.locator('#asks-control').becomesHidden();
  }
  await other.locator('#do-continue:enabled').waitFor();
  await page.locator('#do-continue').becomesDisabled();
  await other.close();
  await page.getByRole('button', {name: 'Take control'}).click();
  await page.locator('#do-continue:enabled').waitFor();
});

step('continues, stops at once, and resumes from the list of runs', async (page) => {
  const held = await measured();
  await page.locator('#do-continue').click();
  await served.pressAt(held + 1, 'do-stop');
  await confirmDialog();
  await stateIs(/^The run is interrupted and can be resumed: .*the stage is halted/);
  const kept = await measured();
  assert.ok(kept > held && kept < ANGLES, `${held} then ${kept}`);
  await page.locator('nav a[href="#runs"]').click();
  await page.locator(`button.resume[data-run="${runName}"]:enabled`).click();
  await confirmDialog();
  await page.locator('#view-live').waitFor();
  await stateIs(/^The run is complete\. Result: usable/);
  await eventually(async () => assert.equal(await measured(), ANGLES));
  await page.locator('nav a[href="#runs"]').click();
  await page.getByRole('link', {name: runName}).click();
  await page.locator('#estimators').waitFor();
  await says('#answer', /interrupted and resumed once/);
});

step('connects again by itself, and the bench does not depend on it', async (page) => {
  await page.setOffline(true);
  await page.setOffline(false);
  await page.reload();
  await page.waitForFunction(() => document.getElementById('link').textContent === 'Connected');
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
