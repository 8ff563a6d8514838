// The start form: a scanner, the register's items, one run for two presses, and two pages.
import assert from 'node:assert/strict';
import {begin, complainsOfNothing, confirmDialog, ENDLESS, eventually, look, says, served, stateIs, text} from './page_test.mjs';
import {logIn, makeRegister} from './training_register.mjs';

const step = begin({pace: 5, bench: ENDLESS.replace('[operator]\nname = "N. N."\n', ''), enter: () => {}, prepare: () => {
  const lab = makeRegister(served);
  lab('add', 'item', '--maker', 'MicroStrain', '--model', '3DM-GV7-AR', '--serial-number', 'SN 0500', '--owner', 'A customer');
}});

const yes = '#confirm-yes:enabled';
const valueIs = (page, id, expected) => eventually(async () => assert.equal(await page.locator(`#start-${id}`).inputValue(), expected));

step('shows before the start what will be done, and what to look at', async (page) => {
  await logIn(page, 'Operator N. N.');
  await served.entered();
  served.problems.length = 0;  // Drops those of the login page.
  await page.locator('#take-control').click();
  await page.locator('#do-start:enabled').click();
  await page.locator(yes).waitFor();
  const facts = await text('#start-facts');
  for (const words of ['Bench 3', 'SIMULATED', 'Operator N. N. (logged in)', 'Predicted duration', '119 angles', 's (sensitivity, relative): ', 'Free disk space', 'none from the console'])
    assert.ok(facts.includes(words), `${words} in ${facts}`);
  await says('#start-notices', /The register has no item 3DM-GV7-AR SN 0417/);
  await page.waitForFunction(() => document.activeElement.id === 'confirm-no');
  await look('start-form');
});

step('takes a serial number from a scanner, which types and ends with Enter', async (page) => {
  await page.keyboard.type('SN 0500');
  await page.keyboard.press('Enter');
  await valueIs(page, 'item', '0');
  await valueIs(page, 'serial-number', 'SN 0500');
  await page.locator(yes).waitFor();
  await says('#start-notices', /^(?![^]*The register has no item)/);
  assert.ok(await page.locator('#confirm').isVisible(), 'Enter of a scanner starts and cancels nothing');
  await page.keyboard.type('<img src=x onerror=alert(1)>');
  await page.keyboard.press('Enter');
  await page.getByText('The register has no item 3DM-GV7-AR <img src=x onerror=alert(1)>').waitFor();
  assert.equal(await page.locator('#confirm img').count(), 0);
  await page.keyboard.type('SN 0500');
  await page.keyboard.press('Enter');
  await valueIs(page, 'item', '0');
  await page.locator(yes).waitFor();
});

step('an answer to what was typed before enables nothing', async (page) => {
  await page.evaluate(() => {
    const asked = globalThis.fetch;
    globalThis.fetch = async (...request) => {
      const response = await asked(...request);
      if (String(request[0]).startsWith('/start-form')) await new Promise((resolve) => { globalThis.letGo = resolve; });
      return response;
    };
    globalThis.fetchAsBefore = () => { globalThis.fetch = asked; };
  });
  await page.locator('#start-steps').selectOption('36');
  await page.waitForFunction(() => globalThis.letGo);
  await page.locator('#start-customer-number').fill('INV-41');
  const isDisabled = await page.evaluate(async () => {
    globalThis.fetchAsBefore();
    globalThis.letGo();
    await new Promise((resolve) => { setTimeout(resolve, 50); });
    return document.getElementById('confirm-yes').disabled;
  });
  assert.ok(isDisabled, 'the answer does not contain the text that was typed since');
  await page.locator(yes).waitFor();
});

step('a question whose place newer ones took is asked again', async (page) => {
  await page.evaluate(() => {
    const asked = globalThis.fetch;
    let refused = 0;
    globalThis.fetch = (...request) => (++refused > 2 ? asked(...request) : Promise.resolve(new Response('A newer request took its place.', {status: 429})));
    globalThis.fetchAsBefore = () => { globalThis.fetch = asked; return refused; };
  });
  await page.locator('#start-customer-number').fill('INV-40');
  await page.locator(yes).waitFor();
  assert.ok(await page.evaluate(() => globalThis.fetchAsBefore()) >= 3);
  assert.doesNotMatch(await text('#start-notices'), /took its place/);
});

step('two presses start one run, of the item and the plan that were chosen', async (page) => {
  await page.locator('#start-steps').selectOption('72');
  await page.locator('#start-customer-number').fill('INV-42');
  await says('#start-facts', /227 angles/);
  await page.locator(yes).waitFor();
  await page.locator('#confirm-yes').dblclick();
  await served.measuredAtLeast(2);
  await says('#item', 'SN 0500');
  await says('#measured', /^\d+ of 227$/);
  await page.locator('#do-stop:enabled').click();
  await stateIs(/^The run is interrupted/);
});

step('a form that another page has overtaken starts nothing', async (page) => {
  await page.locator('#do-start:enabled').click();
  await page.locator(yes).waitFor();
  await says('#start-notices', /was interrupted/);
  const other = await served.newPage();  // A page of the same person.
  await other.goto(served.address);
  await other.getByRole('button', {name: 'Take control from the other page'}).click();
  await other.locator('#confirm-yes').click();
  await page.getByText(/This page no longer has control/).waitFor();
  await page.front();
  await confirmDialog();
  await page.getByText('Start: refused: this page only watches; take control first').waitFor();
  await other.close();
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
