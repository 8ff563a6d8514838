// The page of the search: asks while a person types, and shows the hits.
(function () {
  'use strict';
  const index = abcalSearch.load(window.abcalSearchIndex);
  const input = document.getElementById('question');
  const list = document.getElementById('hits');
  const count = document.getElementById('hit-count');

  function linkTo({page, anchor}, words) {
    const link = document.createElement('a');
    link.href = page.replace(/\.md$/, '.html') + (anchor ? '#' + anchor : '');
    link.textContent = words;
    return link;
  }

  // A piece of the text around the first word that was found, with what was found in bold.
  function excerpt(text, terms) {
    const found = new Set(terms);
    const words = text.split(/(\s+)/);
    const isFound = (word) => abcalSearch.tokens(word).some((token) => found.has(abcalSearch.term(token)));
    const first = Math.max(0, words.findIndex(isFound));
    const from = Math.max(0, first - 16);
    const paragraph = document.createElement('p');
    if (from > 0) paragraph.append('... ');
    for (const word of words.slice(from, from + 80)) {
      if (isFound(word)) {
        const bold = document.createElement('b');
        bold.textContent = word;
        paragraph.append(bold);
      } else {
        paragraph.append(word);
      }
    }
    if (from + 80 < words.length) paragraph.append(' ...');
    return paragraph;
  }

  function show(question) {
    list.replaceChildren();
    count.textContent = '';
    if (!question.trim()) return;
    const hits = abcalSearch.ask(index, question);
    const unknown = abcalSearch.unknownWords(index, question);
    count.textContent = hits.length === 0 ? 'No page has these words.' : `${hits.length} pages`;
    if (hits.length > 0 && unknown.length > 0) count.textContent += `. No page has: ${unknown.join(', ')}`;
    for (const hit of hits.slice(0, 12)) {
      const item = document.createElement('li');
      item.append(linkTo(hit, hit.heading === hit.title ? hit.title : `${hit.title}: ${hit.heading}`), excerpt(hit.text, hit.terms));
      const further = hit.sections.slice(1, 3);
      if (further.length > 0) {
        const line = document.createElement('p');
        line.className = 'abcal-further';
        line.append('also: ');
        further.forEach((section, i) => line.append(i > 0 ? ', ' : '', linkTo(section, section.heading)));
        item.append(line);
      }
      list.append(item);
    }
  }

  input.value = new URLSearchParams(location.search).get('q') ?? '';
  input.addEventListener('input', () => show(input.value));
  input.form.addEventListener('submit', (event) => {
    event.preventDefault();
    show(input.value);
  });
  show(input.value);
})();
