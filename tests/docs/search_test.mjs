// Asks the search of the site the questions of new users. Each has one of its answers among the first three hits.
// The index is made here of the same pages, so that neither Sphinx nor a browser is needed.
import {existsSync, readFileSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import {allSections, docs, searchOfTheSite} from '../../scripts/site/documents.mjs';

const miniSearch = path.join(process.env.ABCAL_SITE_MODULES ?? 'build/site_modules/node_modules', 'minisearch/dist/umd/index.js');
if (!existsSync(miniSearch)) {
  console.log(`skipped: ${miniSearch} is not there (scripts/setup --tests)`);
  process.exit(77);
}
const search = searchOfTheSite(miniSearch);
const sections = allSections();
const index = search.load(JSON.stringify(search.build(sections)));
const {questions} = JSON.parse(readFileSync(path.join(path.dirname(fileURLToPath(import.meta.url)), 'questions.json'), 'utf8'));
const known = new Set(sections.flatMap(({page, anchor}) => [page, `${page}#${anchor}`]));

let failed = 0;
function fail(message) {
  console.error(message);
  ++failed;
}

if (questions.length < 60) fail(`${questions.length} questions; required: at least 60`);
for (const {question, answers} of questions) {
  for (const answer of answers)
    if (!known.has(answer)) fail(`"${question}": its answer ${answer} is not below ${docs}`);
  const hits = search.ask(index, question).slice(0, 3);
  // The page shows the first three sections of a hit.
  const shown = new Set(hits.flatMap((hit) => [hit.page, ...hit.sections.slice(0, 3).map(({page, anchor}) => `${page}#${anchor}`)]));
  if (!answers.some((answer) => shown.has(answer)))
    fail(`"${question}": required: one of ${answers.join(', ')}; found: ${hits.map((hit) => `${hit.page}#${hit.anchor}`).join(', ')}`);
}
// Nothing is found for a word that no page has, and the search says so: the hits above are hits.
if (search.ask(index, 'xylophone').length > 0) fail('"xylophone" has hits');
const unknown = search.unknownWords(index, 'a xylophone on an Arduino').join();
if (unknown !== 'xylophone') fail(`words that no page has: found: ${unknown}; required: xylophone`);
// The record of changes and decisions is no answer.
for (const {page} of sections) if (/^(changelog|decisions)/.test(page)) fail(`${page} is in the index`);
console.log(`${questions.length} questions, ${sections.length} sections, ${failed} failures`);
process.exit(failed > 0 ? 1 : 0);
