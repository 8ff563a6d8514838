// Lighthouse, in Chromium: accessibility, and how much the page shifts while it is loaded.
import assert from 'node:assert/strict';
import path from 'node:path';
import {pathToFileURL} from 'node:url';
import {abcal, begin, served} from './page_test.mjs';
import {fromRegistry} from './served_page.mjs';

const step = begin({pace: 10, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run')});
const {default: lighthouse} = await import(pathToFileURL(fromRegistry.resolve('lighthouse')));

const tries = 3;

// The result of Lighthouse for a view. On a busy machine the browser's trace may lack the data for the layout shift: Lighthouse
// then gives no figure, and the view is measured again.
async function measured(view) {
  for (let attempt = 1; ; ++attempt) {
    const page = await served.newPage();
    const {lhr} = await lighthouse(`${served.address}#${view}`, {onlyCategories: ['accessibility'], onlyAudits: ['cumulative-layout-shift', 'layout-shifts'],
      formFactor: 'desktop', screenEmulation: {disabled: true}, throttlingMethod: 'provided', logLevel: 'error', maxWaitForLoad: 5000, disableFullPageScreenshot: true}, undefined, page.page);
    await page.close();
    const audit = lhr.audits['cumulative-layout-shift'];
    if (Number.isFinite(audit.numericValue)) return lhr;
    console.log(`${view}: no figure at attempt ${attempt}: ${audit.errorMessage ?? lhr.runtimeError?.message ?? 'Lighthouse does not say why'}`);
    assert.ok(attempt < tries, `${view}: Lighthouse gave no layout shift in ${tries} attempts`);
  }
}

// Each takes 14 s on two busy processors; shift_test.mjs measures the same of all views.
for (const view of ['live', 'runs/first.run']) {
  step(view, async () => {
    const lhr = await measured(view);
    const failed = Object.values(lhr.audits).filter(({score}) => score !== null && score < 1).map(({id}) => id);
    const shift = lhr.audits['cumulative-layout-shift'].numericValue;
    console.log(`${view}: accessibility ${100 * lhr.categories.accessibility.score}, cumulative layout shift ${shift.toFixed(4)}`);
    for (const {node} of lhr.audits['layout-shifts']?.details?.items ?? []) console.log(`  ${node?.snippet}`);
    assert.equal(lhr.categories.accessibility.score, 1, failed.join(', '));
    assert.ok(shift < 0.05, `${shift}`);
  });
}
