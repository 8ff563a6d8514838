// The runs of the folder: list with search, one run's results, comparison of two, control chart of one item.
import {byId, decimals, duration, element, number, scrollable, signed, small, table, DASH} from '/text.js';
import {said} from '/said.js';
import {operatorIn, rolesIn, t} from '/language.js';
import {fetched} from '/fetched.js';
import {PagedTable} from '/pages.js';
import {certificateCard} from '/approve.js';
import {resultItems} from '/items.js';
import {askForView, savesPatiently} from '/making.js';
import {timeElement, timeText} from '/time.js';
import {OUTPUTS, band, bars, discard} from '/plots.js';

const VERDICTS = {usable: t('Usable'), doubtful: t('Doubtful'), not_usable: t('Not usable')};
const STATES = {running: t('running, or its program died'), interrupted: t('interrupted'), complete: t('complete'), abandoned: t('abandoned'), unreadable: t('cannot be read'), 'not read yet': t('is being read')};
const ESTIMATORS = {abc: 'ABC', joint: 'joint', norm: 'norm'};
const HEADINGS = [t('Run'), t('Item (serial number)'), t('Model'), t('Begun'), t('State'), t('Result'), t('Operator'), t('Measured'), t('Duration'), t('Go on')];
const ROWS = 100;  // Rows on one page of the list.
const PROPERTIES = ['s_u', 's_v', 's_w', 'phi_uv', 'phi_vw', 'phi_wu', 'O_u', 'O_v', 'O_w'];
const SYMBOLS = t('s_ux: sensitivity of output u along axis x of the stage; s_u: its intrinsic sensitivity, independent of the mounting; phi_uv: angle between u and v; O_u: offset of u.');

// "s_u: sensitivity of output u".
function inWords(property) {
  const [kind, outputs] = property.split('_');
  const words = {s: t`sensitivity of output ${outputs}`, phi: t`angle between outputs ${outputs[0]} and ${outputs[1]}`, O: t`offset of output ${outputs}`};
  return `${property}: ${words[kind]}`;
}

let list = [], firstRow = 0;
const charts = [];

async function fetchJson(path) {
  const response = await fetched(path);
  if (!response.ok) throw new Error((await response.text()).trim() || t`the console answered ${response.status}`);
  return response.json();
}

const encoded = (name) => encodeURIComponent(name);
const day = (utc) => timeElement(utc, 'day');

function clearCharts() {
  while (charts.length) discard(charts.pop());
}

function say(id, error) {
  byId(id).replaceChildren(element('p', {role: 'alert', class: 'grade-problem'}, said(error.message || String(error), {capital: true})));
}

// The list.

export async function showRuns(resume) {
  byId('run-list').hidden = false;
  byId('run-detail').replaceChildren();
  clearCharts();
  try {
    list = await fetchJson('/runs');
  } catch (error) {
    return say('run-table', error);
  }
  // Many runs are read in steps; those already read are shown meanwhile.
  const unread = list.filter((run) => run.state === 'not read yet').length;
  byId('run-loading').textContent = unread ? t`Reading: ${unread} of ${list.length} runs are still to come.` : '';
  if (unread) setTimeout(() => { if (location.hash === '#runs') showRuns(resume); }, 200);
  const search = byId('run-search');
  search.oninput = () => { firstRow = 0; drawList(resume); };
  drawList(resume);
}

// Marks a run of simulated instruments, so that nobody takes it for a calibration.
export function simulatedMark(run) {
  return element('strong', {class: 'simulated', title: t`Simulated: ${rolesIn(run.simulated)}`}, t('SIMULATED'));
}

function matches(run, words) {
  const text = Object.values(run).join(' ').toLowerCase();
  return words.every((word) => text.includes(word));
}

function drawList(resume) {
  const words = byId('run-search').value.toLowerCase().split(/\s+/).filter(Boolean);
  const found = list.filter((run) => matches(run, words));
  if (firstRow >= found.length) firstRow = 0;
  const shown = found.slice(firstRow, firstRow + ROWS);
  byId('run-count').textContent = t`${found.length} of ${list.length} runs` + (shown.length < found.length ? t`; here ${firstRow + 1} to ${firstRow + shown.length}` : '');
  drawPages(found.length, resume);
  const row = (run) => {
    const link = element('a', {href: `#runs/${encoded(run.name)}`}, run.name);
    const actions = element('td', {});
    const measured = run.state === 'complete';
    if (run.state === 'interrupted' || run.state === 'running' || (measured && run.analysed === false)) {
      const word = measured ? t('Analyse') : t('Resume');
      const button = element('button', {type: 'button', class: 'resume', 'data-run': run.name, 'aria-label': `${word} ${run.name}`}, word);
      button.addEventListener('click', () => resume(run.name, measured, run.items.filter(({dropped}) => !dropped).length));
      button.disabled = !document.body.classList.contains('may-resume');
      actions.append(button);
    }
    const cell = (i, ...content) => element('td', {'data-heading': HEADINGS[i]}, ...content);
    return element('tr', {},
      element('th', {scope: 'row'}, run.state === 'unreadable' ? run.name : link),
      cell(1, run.item || DASH),
      cell(2, [run.maker, run.model].filter(Boolean).join(' ') || DASH),
      cell(3, day(run.created_utc)),
      cell(4, element('span', {}, ...(run.simulated ? [simulatedMark(run), ' '] : []), run.why ? `${STATES[run.state]}: ${run.why}` : `${STATES[run.state] || run.state}${measured && run.analysed === false ? t(', not analysed') : ''}`)),
      cell(5, VERDICTS[run.verdict] || DASH),
      cell(6, operatorIn(run.operator) || DASH),
      cell(7, run.planned ? t`${run.measured} of ${run.planned} angles` : DASH),
      cell(8, duration(run.duration_s)),
      actions);
  };
  byId('run-table').replaceChildren(element('table', {},
    element('caption', {class: 'visually-hidden'}, t('Runs in the run folder, newest first')),
    element('thead', {}, element('tr', {}, ...HEADINGS.map((w) => element('th', {scope: 'col'}, w)))),
    element('tbody', {}, ...shown.map(row))));
}

function drawPages(found, resume) {
  const go = (words, to) => {
    const button = element('button', {type: 'button', disabled: to < 0 || to >= found}, words);
    button.addEventListener('click', () => { firstRow = to; drawList(resume); byId('run-search').focus(); });
    return button;
  };
  byId('run-pages').replaceChildren(...(found > ROWS ? [go(t('Newer runs'), firstRow - ROWS), go(t('Older runs'), firstRow + ROWS)] : []));
}

// One run.

// Loads the list of runs, or the page of a run that was not complete, again: a state shown may be outdated.
let showAgain = null;
export function statesMayHaveChanged(resume) {
  if (location.hash === '#runs') showRuns(resume);
  else if (location.hash.startsWith('#runs/')) showAgain?.();
}

// item: its number; absent: the first that was not left out.
export async function showRun(name, item, {again = false} = {}) {
  showAgain = null;
  byId('run-list').hidden = true;
  clearCharts();
  const detail = byId('run-detail');
  let data;
  try {
    data = await askForView(`/runs/${encoded(name)}${item ? `/items/${encoded(item)}` : ''}/result`, detail, t`Reading and analysing ${name}`);
  } catch (error) {
    return say('run-detail', error);
  }
  if (!data) return;
  const {run, results} = data;
  if (run.state !== 'complete') showAgain = () => showRun(name, item, {again: true});
  // The first result is that of the estimator chosen for the run; the fits of the published protocol show properties of the stage.
  const reported = results[0], abc = results.find((r) => r.estimator === 'abc'), joint = results.find((r) => r.estimator === 'joint');
  detail.replaceChildren(
    element('p', {class: 'no-print'}, element('a', {href: '#runs'}, t('All runs'))),
    element('h3', {id: 'run-name'}, run.name),
    ...(run.items.length > 1 ? [resultItems(run, data.item), element('h3', {id: 'run-item'}, t`Result of item ${data.item}`)] : []),
    verdict(reported, run),
    downloads(data.downloads, run, run.items.length > 1 ? data.item : 0),
    card(t('Checks of the result'), checks(reported, data.meanings)),
    ...(reported.stage_record ? [card(t('Record of the stage'), stageRecord(reported.stage_record))] : []),
    ...(reported.diagnostics.flags.length ? [card(t('Flagged angles'), flagged(reported, data.meanings))] : []),
    ...(data.certificate ? [card(t('What the certificate states'), certified(data.certificate))] : []),
    card(t('Estimators side by side'), estimators(results)),
    card(t('Other estimators in words'), element('ul', {}, ...results.slice(1).map((r) => element('li', {}, `${ESTIMATORS[r.estimator]}: ${VERDICTS[r.verdict]}. `, said(r.why))))),
    card(t('Facts'), facts(data)));
  if (abc.diagnostics.closures.length) detail.append(closures(abc));
  detail.append(harmonics(abc));
  if (joint && joint.step_error) detail.append(stepErrors(joint));
  detail.append(certificateCard(run, run.items.length > 1 ? data.item : 0, () => showRun(name, item)));
  detail.append(card(t('Events'), scrollable('scroll', t('Events of the run'), table(t('Events of the run'), [t('Time'), t('Kind'), t('Event')],
    data.events.map((e) => [day(e.utc), said(e.kind), said(e.text)])))));
  if (!again) byId('main').focus();
}

const card = (title, content) => element('section', {class: 'card block'}, element('h3', {}, title), content);

function verdict(result, run) {
  const notes = result.diagnostics.notes;
  return element('div', {class: `verdict verdict-${run.simulated ? 'simulated' : result.verdict}`, id: 'verdict'},
    element('p', {}, ...(run.simulated ? [simulatedMark(run), t` Simulated: ${rolesIn(run.simulated)}. These are no measurements. `] : []),
      element('strong', {}, `${VERDICTS[result.verdict]}. `), said(result.why),
      run.state === 'complete' ? '' : t` The run is ${STATES[run.state]}: ${run.measured} of ${run.planned} angles are measured.`),
    ...(notes.length ? [element('ul', {}, ...notes.map((note) => element('li', {}, said(note))))] : []));
}

// A table of the checks: the failed ones first, with the reason; each with its meaning.
function checks(result, meanings) {
  const all = [...result.diagnostics.checks].sort((a, b) => a.passed - b.passed);
  if (!all.length) return element('p', {}, t('Nothing was checked: the result has too few angles.'));
  const figure = (value, against) => (value === null ? DASH : number(value, Math.min(9, decimals(Math.abs(value) < 1e-3 * against ? 1e-3 * against : value))).replace('-', '−'));
  const outcome = (c) => element('span', {class: c.passed ? 'grade-good' : 'grade-problem'}, c.found === null && c.passed ? t('not made') : c.passed ? t('passed') : t('FAILED'));
  const failed = all.filter((c) => !c.passed).length;
  const made = scrollable('stack scroll-x', t('Checks of the result'), table(failed ? t`${failed} of ${all.length} checks failed.` : t`All ${all.length} checks passed. On a sound bench each fails about once in a million runs.`,
    [t('Check'), t('Outcome'), t('Found'), t('Limit'), t('Unit'), t('Meaning')],
    all.map((c) => [said(c.check), outcome(c), figure(c.found, c.limit), figure(c.limit, c.limit), said(c.unit),
      element('span', {}, said(meanings[c.check]), ...(c.words ? [' ', element('strong', {}, said(c.words, {capital: true}), '.')] : []))])));
  made.id = 'result-checks';
  return made;
}

// Age and health of the record from which the result takes the stage: the parts of the stage that this run tested.
function stageRecord(record) {
  const outcome = (passed) => element('span', {class: passed ? 'grade-good' : 'grade-problem'}, passed ? t('agrees') : t('CONTRADICTS'));
  const figure = (value, words) => (value === null ? DASH : words(value));
  const made = scrollable('stack scroll-x', t('Record of the stage'), table(
    t`${record.stage}: learned ${record.learned_utc.slice(0, 10)} from ${record.runs} runs; ${record.age_months.toFixed(1)} months old, good for ${record.validity_months.toFixed(1)}.`,
    [t('Part of the stage'), t('Outcome'), t('Times what the record expects'), t('Probability')],
    record.tests.map((one) => [said(one.part), outcome(one.passed), figure(one.times_expected, (x) => x.toFixed(2)), figure(one.probability, (p) => p.toPrecision(2))])));
  made.id = 'result-stage-record';
  return made;
}

function flagged(result, meanings) {
  const {flags, angles_used: used} = result.diagnostics;
  const made = scrollable('stack scroll-x', t('Flagged angles'), table(t`Of ${used} angles used; an angle may have several flags.`,
    [t('Flag'), t('Angles'), t('Meaning')], flags.map((f) => [said(f.flag), f.dwells, said(meanings[f.flag])])));
  made.id = 'result-flags';
  return made;
}

// item: its number; 0: the run has one item.
function downloads(kinds, run, item) {
  const bar = element('p', {class: 'bar'}, t('Download:')), making = element('div', {class: 'bar'});
  for (const {name, words} of kinds || []) {
    const link = element('a', {class: 'button', href: `/runs/${encoded(run.name)}${item ? `/items/${item}` : ''}/${name}`,
      download: `${run.name.replace(/\.run$/, '')}${item ? `-item-${item}` : ''}-${name}`}, t(words));
    bar.append(name.endsWith('.pdf') ? savesPatiently(link, making) : link);
  }
  return element('div', {}, bar, making);
}

function quantities(result) {
  const all = [];
  if (result.sensitivity_matrix) {
    result.sensitivity_matrix.forEach((row, j) => row.forEach((q, k) => all.push([`s_${OUTPUTS[j]}${'xyz'[k]}`, q])));
  }
  result.intrinsic_sensitivity.forEach((q, j) => all.push([`s_${OUTPUTS[j]}`, q]));
  result.intrinsic_angle.forEach((q, j) => all.push([`phi_${['uv', 'vw', 'wu'][j]}`, q]));
  result.offset.forEach((q, j) => all.push([`O_${OUTPUTS[j]}`, q]));
  return new Map(all);
}

// The main results in the words and digits of the certificate: a scope of the laboratory may have raised U.
const CERTIFIED = ['abc_sensitivityMatrix', 'abc_intrinsicSensitivities', 'abc_intrinsicAngles', 'abc_offsets', 'abc_conformity'];
const CONFORMITY = {pass: t('pass'), conditionalPass: t('conditional pass'), conditionalFail: t('conditional fail'), fail: t('fail')};
const SCOPE = {raised: t('U raised'), outside: t('outside')};

function certified({number: of, results}) {
  const main = results.filter(({result}) => CERTIFIED.includes(result)), last = main.at(-1)?.calibration;
  const rows = main.filter(({calibration}) => calibration === last).flatMap(({statements}) => statements)
    .map(({quantity, printed, conformity, scope}) => [quantity, printed.value, printed.expanded_uncertainty ?? DASH, printed.coverage_factor ?? DASH, printed.unit, CONFORMITY[conformity] ?? DASH, SCOPE[scope] ?? DASH]);
  const made = table(t`Certificate ${of}: s is per m/s²; U = k u. The other tables of this page are of the analysis, where s is per local gravity and U is not raised to the scope of the laboratory.`,
    [t('Quantity'), t('Value'), 'U', 'k', t('Unit'), t('Decision'), t('Scope')], rows);
  made.id = 'certified';
  return scrollable('scroll-x', t('What the certificate states'), made);
}

function estimators(results) {
  const per = results.map(quantities);
  const names = [...per[0].keys()].length ? [...per[0].keys()] : [...per[1].keys()];
  const head = [t('Quantity'), t('Unit'), ...results.flatMap((r) => [t`${ESTIMATORS[r.estimator]}: value`, t('std. uncertainty')])];
  const rows = names.map((name) => {
    const unit = per.map((p) => p.get(name)).find((q) => q && q.unit)?.unit || '1';
    return [name, unit, ...per.flatMap((p) => {
      const q = p.get(name);
      return q ? [signed(q.value, decimals(q.standard_uncertainty)), small(q.standard_uncertainty)] : [DASH, DASH];
    })];
  });
  const made = table(t`Standard uncertainties (k = 1). A dash: this estimator does not give it. ${SYMBOLS}`, head, rows);
  made.id = 'estimators';
  return scrollable('scroll-x', t('Estimators side by side'), made);
}

function facts(data) {
  const dl = element('dl', {});
  const fact = (name, value) => dl.append(element('dt', {}, name), element('dd', {}, value || DASH));
  const {run, timing} = data;
  fact(t('Item (serial number)'), run.item);
  for (const i of run.items.length > 1 ? run.items : []) fact(t`Item ${i.k}`, i.dropped ? t`${i.model} ${i.serial_number}, left out: ${i.dropped}` : t`${i.model} ${i.serial_number}, ${i.measured} angles`);
  fact(t('Bench'), run.bench);
  fact(t('Operator'), operatorIn(run.operator));
  fact(t('Begun'), day(run.created_utc));
  const {angles_used: used, flags} = data.results[0].diagnostics;
  fact(t('Angles used'), `${used}`);
  fact(t('Flagged angles'), flags.length ? flags.map((f) => `${f.flag}: ${f.dwells}`).join('; ') : t('none'));
  fact(t('Moving, settling, reading, else'), [timing.moving_s, timing.settling_s, timing.dwelling_s, timing.overhead_s].map(duration).join(', '));
  for (const i of data.instruments) fact(t(i.role[0].toUpperCase() + i.role.slice(1)), t`${i.maker} ${i.model}, serial number ${i.serial_number || t('not stated')}`);
  fact(t('Program'), data.program_version);
  return dl;
}

function closures(result) {
  const rows = result.diagnostics.closures;
  const canvas = element('canvas', {role: 'img', 'aria-label': t('Closures in standard uncertainties; the table has the numbers')});
  const block = card(t('Closures: zero for a perfect stage'), element('div', {},
    element('div', {class: 'plot'}, canvas),
    element('details', {}, element('summary', {}, t('As a table')), table(t`Closures and their standard uncertainty (${result.response_unit})`,
      [t('Closure'), t('Output'), t`Value (${result.response_unit})`, t`std. uncertainty (${result.response_unit})`, t('Ratio (1)')],
      rows.map((c) => [c.name, c.accelerometer, small(c.value.value), small(c.value.standard_uncertainty), signed(c.value.value / c.value.standard_uncertainty, 2)])))));
  queueMicrotask(() => charts.push(bars(canvas, {y: t('closure / std. uncertainty (1)'), labels: [...new Set(rows.map((c) => c.name))],
    sets: OUTPUTS.map((name) => ({output: name, values: rows.filter((c) => c.accelerometer === name).map((c) => c.value.value / c.value.standard_uncertainty)}))})));
  return block;
}

function harmonics(result) {
  const canvas = element('canvas', {role: 'img', 'aria-label': t('Amplitudes of the harmonics 2 to 5; the table has the numbers')});
  const rows = [];
  for (const fit of result.diagnostics.fits) {
    for (const h of fit.harmonics.filter((x) => x.order >= 2)) {
      rows.push({label: `${fit.experiment}, ${h.order}`, experiment: fit.experiment, output: fit.accelerometer, order: h.order,
        amplitude: Math.hypot(h.sin.value, h.cos.value), u: Math.hypot(h.sin.standard_uncertainty, h.cos.standard_uncertainty) / Math.SQRT2});
    }
  }
  if (!rows.length) return card(t('Harmonics'), element('p', {}, t('These angles do not determine harmonics.')));
  const unit = result.response_unit;
  const block = card(t('Harmonics 2 to 5 of the response'), element('div', {},
    element('div', {class: 'plot'}, canvas),
    element('details', {}, element('summary', {}, t('As a table')), table(t`Amplitudes (${unit})`,
      [t('Experiment'), t('Order (1)'), t('Output'), t`Amplitude (${unit})`, t`std. uncertainty of a coefficient (${unit})`],
      rows.map((r) => [r.experiment, r.order, r.output, small(r.amplitude), small(r.u)])))));
  const labels = [...new Set(rows.map((r) => r.label))];
  queueMicrotask(() => charts.push(bars(canvas, {x: t('experiment, order of the harmonic'), y: t`amplitude (${unit})`, labels,
    sets: OUTPUTS.map((name) => ({output: name, values: labels.map((l) => rows.find((r) => r.label === l && r.output === name)?.amplitude ?? null)}))})));
  return block;
}

function stepErrors(joint) {
  const holder = element('div', {class: 'plots'});
  const rows = [];
  joint.step_error.forEach((errors, i) => {
    const canvas = element('canvas', {role: 'img', 'aria-label': t`Step errors of experiment ${i + 1}; the table has the numbers`});
    holder.append(element('div', {}, element('h4', {}, t`Experiment ${i + 1}: axis ${i === 2 ? 'Z' : 'X'}`), element('div', {class: 'plot'}, canvas)));
    const points = errors.map((q, k) => ({n: k + 1, ...q})).filter((q) => q.value !== null);
    for (const p of points) rows.push([i + 1, p.n, signed(p.value, 5), number(p.standard_uncertainty, 5)]);
    queueMicrotask(() => charts.push(band(canvas, {x: t('number n of the angle (1)'), y: t('step error (degrees)'), output: OUTPUTS[i],
      points: points.map((p) => ({x: p.n, y: p.value, u: p.standard_uncertainty}))})));
  });
  const pages = scrollable('scroll', t('Step errors (degrees)'), '');
  new PagedTable(pages, {caption: () => t('Step errors (degrees)'), rows: (from, to) => rows.slice(from, to),
    head: () => [t('Experiment'), 'n', t('Step error (degrees)'), t('std. uncertainty (degrees)')]}).show(rows.length);
  return card(t('Step errors of the stage, from the joint estimator'), element('div', {},
    element('p', {}, t('Line: estimated error of each commanded angle; band: two standard uncertainties.')), holder,
    element('details', {}, element('summary', {}, t('As a table')), pages)));
}

// Two runs.

export async function showCompare(first, second) {
  clearCharts();
  try {
    list = await fetchJson('/runs');
  } catch (error) {
    return say('compare-table', error);
  }
  const usable = list.filter((run) => run.state === 'complete');
  // The items of a run with several are listed singly: NAME#K.
  const choices = usable.flatMap((run) => run.items.filter(({dropped}) => dropped === null).map(({k, serial_number: serial}) => ({run, serial, name: run.items.length > 1 ? `${run.name}#${k}` : run.name})));
  const fill = (id, chosen) => byId(id).replaceChildren(...choices.map(({run, serial, name}) => element('option', {value: name, selected: name === chosen}, `${name} (${serial || t('no serial number')})${run.simulated ? ` ${t('SIMULATED')}` : ''}`)));
  fill('compare-a', first || choices[1]?.name);
  fill('compare-b', second || choices[0]?.name);
  byId('compare-form').onsubmit = (event) => {
    event.preventDefault();
    compare(byId('compare-a').value, byId('compare-b').value);
  };
  byId('compare-form').querySelector('button').disabled = choices.length < 2;
  if (choices.length < 2) byId('compare-table').replaceChildren(element('p', {}, t('Two complete runs are needed.')));
}

async function compare(a, b) {
  let data;
  try {
    data = await fetchJson(`/compare/${encoded(a)}/${encoded(b)}${byId('compare-shared').checked ? '/shared-stage' : ''}`);
  } catch (error) {
    return say('compare-table', error);
  }
  const [pair] = data.pairs;
  const row = (name) => {
    const first = data.results[0].properties[name], second = data.results[1].properties[name], both = pair.properties[name];
    return [name, first.unit, ...[first, second].flatMap((q) => [signed(q.value, decimals(q.standard_uncertainty)), small(q.standard_uncertainty)]),
      signed(both.difference, decimals(both.standard_uncertainty)), small(both.standard_uncertainty), signed(both.e_n, 2)];
  };
  const simulated = list.filter((run) => run.simulated && [a, b].some((name) => name === run.name || name.startsWith(`${run.name}#`)));
  byId('compare-table').replaceChildren(
    element('p', {id: 'compare-words', role: 'status'}, ...simulated.flatMap((run) => [simulatedMark(run), t` ${run.name} is simulated: no measurement. `]), said(pair.why)),
    scrollable('scroll-x', `A: ${a}. B: ${b}.`, table(t`Properties that do not depend on mounting, by the ABC estimator; E_n with U = 2 u. A: ${a}. B: ${b}.`,
      [t('Property'), t('Unit'), 'A', t('std. unc. of A'), 'B', t('std. unc. of B'), t('B minus A'), t('std. unc. of it'), 'E_n (1)'], PROPERTIES.map(row))),
    element('ul', {}, ...data.notes.map((note) => element('li', {}, said(note)))));
}

// The control chart.

export async function showChart(serial) {
  clearCharts();
  try {
    list = await fetchJson('/runs');
  } catch (error) {
    return say('chart-body', error);
  }
  const measured = (run) => run.items.filter((item) => item.dropped === null).map((item) => item.serial_number);
  const items = [...new Set(list.filter((run) => run.state === 'complete').flatMap(measured).filter(Boolean))].sort();
  byId('chart-item').replaceChildren(...items.map((item) => element('option', {value: item, selected: item === serial}, item)));
  byId('chart-property').replaceChildren(...PROPERTIES.map((p) => element('option', {value: p}, inWords(p))));
  byId('chart-form').onchange = () => drawChart(byId('chart-item').value, byId('chart-property').value);
  byId('chart-form').onsubmit = (event) => {
    event.preventDefault();
    drawChart(byId('chart-item').value, byId('chart-property').value);
  };
  byId('chart-form').querySelector('button').disabled = items.length === 0;
  if (!items.length) byId('chart-body').replaceChildren(element('p', {}, t('No complete run of an item with a serial number exists yet.')));
  else drawChart(byId('chart-item').value, PROPERTIES[0]);
}

async function drawChart(serial, property) {
  let data;
  try {
    data = await fetchJson(`/history/${encoded(serial)}/${property}`);
  } catch (error) {
    return say('chart-body', error);
  }
  clearCharts();
  const points = data.runs.map((run, i) => ({run, x: i + 1, value: run.value, standard_uncertainty: run.standard_uncertainty, unit: run.unit})).filter((p) => p.value !== null);
  const limits = data.limits;
  const unit = points[0]?.unit || '1';
  const canvas = element('canvas', {role: 'img', 'aria-label': t`Control chart of ${inWords(property)}; the table has the numbers`});
  const words = limits
    ? t`Centre ${number(limits.centre, decimals(limits.standard_deviation))} ${unit}; limits ${number(limits.lower, decimals(limits.standard_deviation))} to ${number(limits.upper, decimals(limits.standard_deviation))} ${unit} (3 standard deviations from the mean moving range). ` + (limits.outside ? t`${limits.outside} outside.` : t('All inside.'))
    : t('Limits need at least two runs.');
  byId('chart-body').replaceChildren(
    element('p', {id: 'chart-words', role: 'status'}, words),
    element('div', {class: 'plot'}, canvas),
    scrollable('scroll-x', inWords(property), table(t`${inWords(property)}, of item ${serial}, oldest first`, [t('Run'), t('Begun'), t`Value (${unit})`, t`std. uncertainty (${unit})`, t('Limits'), t('Verdict')],
      points.map((p) => [element('a', {href: `#runs/${encoded(p.run.name)}${p.run.item ? `/${p.run.item}` : ''}`}, `${p.x}: ${p.run.name}`), day(p.run.created_utc),
        signed(p.value, decimals(p.standard_uncertainty)), small(p.standard_uncertainty), against(limits, p.value), p.run.simulated ? simulatedMark(p.run) : VERDICTS[p.run.verdict]]))));
  charts.push(band(canvas, {x: t('number and day of the run'), y: `${property} (${unit})`, output: 'u', points: points.map((p) => ({x: p.x, y: p.value, u: p.standard_uncertainty, words: [String(p.x), timeText(p.run.created_utc, 'date')]})), limits, marks: true}));
}

function against(limits, value) {
  if (!limits) return DASH;
  return value < limits.lower || value > limits.upper ? element('span', {class: 'grade-problem'}, t('OUTSIDE')) : t('inside');
}
