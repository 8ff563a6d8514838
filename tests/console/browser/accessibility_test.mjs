// Accessibility of the views that no other test examines: idle, dialog, wall display, printed result.
import assert from 'node:assert/strict';
import {abcal, begin, complainsOfNothing, look, says, served} from './page_test.mjs';

const step = begin({pace: 10, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});

step('before anything was done', () => look('idle'));

step('in a dialog', async (page) => {
  await page.locator('#take-control').click();
  await page.locator('#do-start:enabled').click();
  await page.locator('#confirm-yes:enabled').waitFor();
  await look('dialog');
  await page.locator('#confirm-no').click();
});

step('on a wall', async (page) => {
  await page.locator('nav a[href="#kiosk"]').click();
  await page.waitForFunction(() => document.body.classList.contains('kiosk'));
  await look('kiosk');
  await page.locator('#leave-kiosk').click();
  await page.waitForFunction(() => !document.body.classList.contains('kiosk'));
});

step('a result is printed as a whole, without what can only be pressed', async (page) => {
  await page.goto(`${served.address}#runs/first.run`);
  await page.locator('#estimators').waitFor();
  const pages = await served.print();
  assert.match(pages, /Usable\. /);
  for (const words of ['Checks of the result', 'Estimators side by side', 'Closures and their standard uncertainty', 'Amplitudes', 'Step errors (degrees)', 'Events of the run'])
    assert.ok(pages.includes(words), words);
  assert.ok(!/Stop|Take control|Download|All runs|Log out/.test(pages), pages);
  await page.locator('#estimators').waitFor();
  await says('#banner-word', 'Idle');
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
