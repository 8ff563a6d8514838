// The views of runs in German: no English text that is not marked as English.
import assert from 'node:assert/strict';
import {abcal, begin, complainsOfNothing, eventually, inGerman, look, noEnglish, says, served} from './page_test.mjs';

const step = begin({pace: 10, prepare: () => abcal('run', 'bench.toml', '-o', 'first.run'), enter: inGerman});

for (const [view, last] of Object.entries({runs: '#run-table table', 'runs/first.run': '#certificate p', compare: '#compare-form', chart: '#chart-words'})) {
  step(`${view} is German`, async (page) => {
    await page.goto(`${served.address}#${view}`);
    await page.locator(last).waitFor();
    await noEnglish();
    if (view !== 'runs/first.run') return;
    await says('#verdict', /Chi-Quadrat|die Ablesungen haben keine Unsicherheit/);
    await page.evaluate(() => { document.getElementById('passed-checks').open = true; });
    await says('#result-checks', /Verrutschen/);
    assert.deepEqual(await page.evaluate(() => [...document.querySelectorAll('#result-checks [lang=en], #verdict [lang=en]')].map((each) => each.textContent)), []);
    await look('result-german');
    // A tablet: German words are the longest, and at this width tables are still tables.
    await page.setViewportSize({width: 768, height: 1024});
    await eventually(async () => assert.equal(await page.evaluate(() => Math.max(0, document.documentElement.scrollWidth - innerWidth)), 0));
  });
}

step('loaded nothing from elsewhere, and the browser has nothing to complain of', complainsOfNothing);
