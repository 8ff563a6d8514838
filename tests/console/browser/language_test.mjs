// English and German: every text of the page has a translation, and a German page shows no English of a run that is not marked.
import assert from 'node:assert/strict';
import {readdirSync, readFileSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {barriers, begin, complainsOfNothing, confirmDialog, ENDLESS, eventually, noEnglish, runOver, served, stateIs} from './page_test.mjs';
import {SIZES} from './served_page.mjs';

const folder = path.join(path.dirname(fileURLToPath(import.meta.url)), '../../../app/console/page');
// Imports the text of the file: Node 18 takes "*.js" for a module only if a package.json says so.
const germanOf = async (name) => (await import(`data:text/javascript,${encodeURIComponent(readFileSync(path.join(folder, name), 'utf8'))}`)).default;
const german = await germanOf('de.js');
const step = begin({pace: 5, bench: ENDLESS});
const SAME = new Set(['abcal', 'abcal serve', 'abcal compare --shared', 'Deutsch', 'Esc Esc']);  // Equal in every language.

// The texts in the sources as t`...` or t('...').
function textsOfScripts() {
  const texts = new Set();
  for (const name of readdirSync(folder).filter((file) => file.endsWith('.js') && !['de.js', 'language.js'].includes(file))) {
    const source = readFileSync(path.join(folder, name), 'utf8');
    for (const [, text] of source.matchAll(/\bt`([^`]*)`/g)) texts.add(text.replace(/\$\{[^{}]*\}/g, '{}'));
    for (const [, text] of source.matchAll(/\bt\('([^']*)'\)/g)) texts.add(text);
  }
  return texts;
}

// The texts of a page before any script has touched them.
const textsOfPage = (name) => served.page.evaluate((html) => {
  const page = new DOMParser().parseFromString(html, 'text/html'), texts = [page.title];
  const walker = page.createTreeWalker(page.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) texts.push(walker.currentNode.data.replace(/\s+/g, ' ').trim());
  for (const attribute of ['aria-label', 'title', 'placeholder'])
    for (const element of page.querySelectorAll(`[${attribute}]`)) texts.push(element.getAttribute(attribute));
  return texts.filter((text) => /\p{L}{2}/u.test(text));
}, readFileSync(path.join(folder, name), 'utf8'));

step('every text has German words with the same values in them', async () => {
  const texts = new Set([...textsOfScripts(), ...await textsOfPage('index.html'), ...await textsOfPage('person.html'), ...await textsOfPage('token.html')]);
  assert.ok(texts.size > 250, String(texts.size));
  assert.deepEqual([...texts].filter((text) => !(text in german) && !SAME.has(text) && !/^abcal console$/.test(text)), []);
  const values = (text) => text.split('{}').length;
  assert.deepEqual(Object.keys(german).filter((text) => values(text) !== values(german[text])), []);
});

// The vocabulary of the program, of which the console sends the words alone.
step('checks, flags and what they mean have German words', async (page) => {
  const source = readFileSync(path.join(folder, '../../../protocol/estimators/checks/check_meanings.cc'), 'utf8');
  const pairs = [...source.matchAll(/\{"([^"]+)",\s*"([^"]+)"\}/g)];
  assert.ok(pairs.length >= 30, String(pairs.length));
  const program = await page.evaluate(async () => (await fetch('/certificate_de.json')).json());
  assert.deepEqual(pairs.flatMap(([, name, meaning]) => [name, meaning]).filter((words) => !(words in program)), []);
});

step('a switch chooses German, which stays', async (page) => {
  await page.waitForFunction(() => document.documentElement.lang === 'en');
  await page.locator('#language').click();
  await page.waitForFunction(() => document.documentElement.lang === 'de' && document.getElementById('link').textContent === 'Verbunden');
  await page.locator('#banner-word', {hasText: 'Bereit'}).waitFor();
  await noEnglish();
  for (const size of Object.values(SIZES)) {
    await page.setViewportSize(size);
    await eventually(async () => assert.deepEqual(await runOver(), [], `${size.width} px`));
  }
  await page.setViewportSize(SIZES.desk);
  assert.deepEqual(await barriers(), []);
});

step('a run is German from its first question to its result', async (page) => {
  await page.locator('#take-control').click();
  await page.locator('#do-start:enabled').click();
  await page.locator('#confirm-title', {hasText: 'Lauf beginnen?'}).waitFor();
  await page.locator('#confirm-yes:enabled').waitFor();
  await page.locator('#start-facts', {hasText: 'Vorhergesagte Standardunsicherheiten'}).waitFor();
  await noEnglish();
  await confirmDialog();
  await served.measuredAtLeast(4);
  await noEnglish();
  await page.locator('#do-stop').click();
  await stateIs(/^Der Lauf ist unterbrochen/);
  await page.locator('#halt', {hasText: 'Achse X steht. Achse Z steht.'}).waitFor();
  await noEnglish();
});

step('what a person stated is not translated, whatever it says', async (page) => {
  const says = (message) => page.evaluate(async (made) => {
    const {know, translated} = await import('/said.js');
    know([made]);
    return translated(made.text);
  }, message);
  assert.equal(await says({text: 'Source: customer', id: 'Source: {source}', values: {source: 'customer'}}), 'Quelle: customer');
  assert.equal(await says({text: 'Source: Customer', id: 'Source: {source}', values: {source: {text: 'Customer', id: 'Customer', values: {}}}}), 'Quelle: Auftraggeber');
  assert.equal(await says({text: 'customer', id: '{source}', values: {source: 'customer'}}), 'customer');
  assert.equal(await says({text: 'no sentence of the program', id: 'no sentence of the program', values: {}}), null);
});

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
