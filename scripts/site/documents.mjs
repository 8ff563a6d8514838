// The sections of the pages, as the search of the site knows them: one document for each heading of each page below docs/, but for
// changelog and decisions.
//   node scripts/site/documents.mjs MINISEARCH OUTPUT     writes the index as a script: a page opened from a disk may not fetch
import {readdirSync, readFileSync, writeFileSync} from 'node:fs';
import path from 'node:path';
import {fileURLToPath} from 'node:url';
import vm from 'node:vm';

const here = path.dirname(fileURLToPath(import.meta.url));
export const docs = path.join(here, '../../docs');

// The anchor of a heading as the usual servers of Markdown make it, and as tests/docs/pages_test.cc verifies links:
// "## The XML file!" is #the-xml-file.
export function anchorOf(heading) {
  return heading.toLowerCase().replace(/[^a-z0-9_ -]/g, '').replaceAll(' ', '-');
}

// Markdown as a reader sees it: no fences, no targets of links, no marks.
function plain(markdown) {
  return markdown.replace(/!\[([^\]]*)\]\([^)]*\)/gs, '$1').replace(/\[([^\]]+)\]\([^)]*\)/g, '$1')
    .replace(/^```.*$/gm, '').replace(/^\|[-|: ]+\|$/gm, '').replace(/[`*]|^>|^#+ /gm, '').replace(/ ?\| ?/g, ' · ')
    .replace(/\s+/g, ' ').replace(/( ·)+( |$)/g, ' · ').trim();
}

// @return {id, page, anchor, title, heading, text} of each section; the text before the second heading is the page's first section
export function sectionsOf(page, markdown) {
  const sections = [];
  let code = false, title = '', current;
  const slugs = new Map();
  for (const line of markdown.split('\n')) {
    if (line.startsWith('```')) code = !code;
    const heading = !code && /^(#{1,6}) (.*)$/.exec(line);
    if (heading) {
      const words = plain(heading[2]);
      let anchor = anchorOf(heading[2]);
      const seen = slugs.get(anchor) ?? 0;
      slugs.set(anchor, seen + 1);
      if (seen > 0) anchor += `-${seen}`;
      if (!title) title = words;
      current = {page, anchor: sections.length === 0 ? '' : anchor, title, heading: words, lines: []};
      sections.push(current);
    } else {
      current?.lines.push(line);
    }
  }
  const documents = sections.map(({lines, ...section}) => ({id: `${section.page}#${section.anchor}`, ...section, text: plain(lines.join('\n'))}));
  if (PAGES_OF_ROWS.has(page)) sections.forEach((section) => documents.push(...rowsOf(section)));
  return documents;
}

// Each row of a table of terms, messages or findings answers a question of its own.
const PAGES_OF_ROWS = new Set(['glossary.md', 'troubleshooting.md']);
function rowsOf({lines, ...section}) {
  return lines.filter((line) => /^\| (?!-)/.test(line)).map((line, row) => {
    const [name, ...others] = line.replace(/^\| | \|$/g, '').split(' | ');
    return {id: `${section.page}#${section.anchor}, row ${row}`, ...section, heading: plain(name), text: plain(others.join(' | '))};
  });
}

export function pages(folder = docs) {
  return readdirSync(folder, {recursive: true}).filter((name) => name.endsWith('.md')).sort();
}

// Changes, and reasons of decisions, answer no question of a user.
const isSearched = (page) => page !== 'changelog.md' && !page.startsWith('decisions/');

export function allSections(folder = docs) {
  return pages(folder).filter(isSearched).flatMap((page) => sectionsOf(page, readFileSync(path.join(folder, page), 'utf8')));
}

// MiniSearch and search.js are scripts of a page and run here as there.
export function searchOfTheSite(miniSearch) {
  for (const script of [miniSearch, path.join(here, 'search.js')]) vm.runInThisContext(readFileSync(script, 'utf8'), script);
  return globalThis.abcalSearch;
}

if (process.argv[1] === fileURLToPath(import.meta.url)) {
  const [miniSearch, output] = process.argv.slice(2);
  if (!output) throw new Error('documents.mjs: usage: node documents.mjs MINISEARCH OUTPUT');
  const index = searchOfTheSite(miniSearch).build(allSections());
  writeFileSync(output, `window.abcalSearchIndex = ${JSON.stringify(JSON.stringify(index))};\n`);
  console.log(`${output}: ${index.documentCount} sections`);
}
