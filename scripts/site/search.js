// The search of the built pages: a script of search.html, and of the test that asks it the questions of new users.
(function () {
  'use strict';

  // Words that say nothing about what is asked.
  const emptyWords = new Set(('a about am an and any are as at be been but by can cannot could did do does for from get got had has have he how i if in ' +
    'into is it its me my of on or our out over own she should so some that the their them then there these they this to ' +
    'up us was we were what when where which who why will with would you your mean means').split(' '));

  // Other words for the same, as people ask: "asked: written", one table for all pages.
  const sameWords = {
    sensor: 'accelerometer', sensors: 'accelerometers', simulate: 'simulated', simulation: 'simulated', hardware: 'instruments',
    device: 'instrument', devices: 'instruments', permission: 'permitted', denied: 'permitted',
    accurate: 'uncertainty', accuracy: 'uncertainty', precise: 'uncertainty', error: 'message', multiple: 'several',
    laptop: 'computer', cancel: 'interrupt', abort: 'interrupt', continue: 'resume', table: 'stage', turntable: 'stage', gimbal: 'stage',
    arduino: 'board', esp32: 'board', stm32: 'board', microcontroller: 'board', i2c: 'board', spi: 'board', mpu6050: 'board', adxl345: 'board',
    raspberry: 'linux', imu: 'accelerometer', no: 'without', wraps: 'travel', wrap: 'travel', twist: 'travel', convert: 'unit',
    list: 'supported', rosbag: 'bag', ubuntu: 'debian', fedora: 'debian', docker: 'debian', container: 'debian', mac: 'macos', apple: 'macos',
    uninstall: 'remove', excel: 'spreadsheet', delete: 'remove', license: 'licence', copyright: 'licence', power: 'mains', blackout: 'mains', outage: 'mains',
    recalibrate: 'interval', often: 'interval', bias: 'offset', misalignment: 'angles', drift: 'temperature',
  };

  // "calibrations", "calibrated", "calibrating" and "calibration" are to find one another; English pages need no more.
  function stem(word) {
    if (word.length < 5 || /[0-9_]/.test(word)) return word.length > 3 && word.endsWith('s') && !word.endsWith('ss') ? word.slice(0, -1) : word;
    return word.replace(/(ational|ations|ation|ators|ator|ates|ated|ating|ate|ings|ing|ed|es|s|e)$/, (ending, _, at) => at < 3 ? ending : '');
  }

  function term(word) {
    const lower = word.toLowerCase();
    return emptyWords.has(lower) ? null : stem(lower);
  }

  // "bench_file", "g/g_loc" and "3DM-GV7" are also found by their parts.
  function tokens(text) {
    const found = [];
    for (const word of text.split(/[^\p{L}\p{N}_./-]+/u)) {
      const whole = word.replace(/^[./-]+|[./-]+$/g, '');
      if (!whole) continue;
      found.push(whole);
      const parts = whole.split(/[_./-]+/);
      if (parts.length > 1) found.push(...parts.filter((part) => part.length > 1));
    }
    return found;
  }

  const options = {
    fields: ['heading', 'title', 'text'], storeFields: ['page', 'anchor', 'title', 'heading', 'text'],
    tokenize: tokens, processTerm: term,
  };

  // Pages for those who change the program or follow a number to its source come after pages for those who use it.
  function weightOf(page) {
    if (/^(validation|reproduction)/.test(page)) return 0.3;
    if (/^(protocols\/|theory\/|architecture|conformance|console_compared)/.test(page)) return 0.5;
    if (/^drivers\//.test(page)) return 0.7;  // Alike in much; whoever asks for one names it.
    return 1;
  }

  const matching = {prefix: (word) => word.length > 3, fuzzy: (word) => (word.length > 5 ? 0.15 : false)};

  function build(sections) {
    const index = new MiniSearch(options);
    index.addAll(sections);
    return index;
  }

  function load(json) {
    return MiniSearch.loadJSON(json, options);
  }

  function withSameWords(question) {
    const added = [];
    for (const word of tokens(question)) if (Object.hasOwn(sameWords, word.toLowerCase())) added.push(sameWords[word.toLowerCase()]);
    return added;
  }

  // @return the words of the question that no page has, nor a word for the same
  function unknownWords(index, question) {
    const found = (word) => index.search(word, matching).length > 0;
    return tokens(question).filter((word) => term(word) && ![word, ...withSameWords(word)].some(found));
  }

  // One hit for each page, its best section first; @return [{page, anchor, title, heading, text, terms, sections}]
  function ask(index, question) {
    const words = {
      combineWith: 'OR',
      queries: [
        {queries: [question], fields: ['heading', 'title', 'text']},
        ...withSameWords(question).map((word) => ({queries: [word], fields: ['heading', 'title', 'text']})),
      ],
    };
    const found = index.search(words, {
      ...matching, boost: {heading: 4, title: 2}, weights: {prefix: 0.4, fuzzy: 0.2},
      boostDocument: (id, word, stored) => weightOf(stored.page),
    });
    const hits = new Map();
    for (const {page, anchor, title, heading, text, terms} of found) {
      const section = {page, anchor, title, heading, text, terms};
      if (hits.has(page)) {
        const {sections} = hits.get(page);
        if (!sections.some((known) => known.anchor === anchor)) sections.push(section);
      } else {
        hits.set(page, {...section, sections: [section]});
      }
    }
    return [...hits.values()];
  }

  globalThis.abcalSearch = {build, load, ask, unknownWords, tokens, term};
})();
