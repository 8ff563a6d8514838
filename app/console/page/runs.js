// The runs of the folder: list with search, one run's results, comparison of two, control chart of one item.
import {byId, decimals, duration, element, number, scrollable, signed, small, table, DASH} from '/text.js';
import {said, term} from '/said.js';
import {operatorIn, rolesIn, t} from '/language.js';
import {fetched} from '/fetched.js';
import {PagedTable} from '/pages.js';
import {certificateCard} from '/approve.js';
import {resultItems} from '/items.js';
import {askForView, savesPatiently} from '/making.js';
import {timeElement, timeText} from '/time.js';
import {answer, valuesOf, VERDICTS, VERDICT_SIGNS} from '/answer.js';
import {motionCard} from '/motion.js';
import {Residuals} from '/residuals.js';
import {Chart, OUTPUTS, overNames, place} from '/plots.js';

const STATES = {running: t('running, or its program died'), interrupted: t('interrupted'), complete: t('complete'), abandoned: t('abandoned'), unreadable: t('cannot be read'), 'not read yet': t('is being read')};
const ESTIMATORS = {abc: 'ABC', joint: 'joint', norm: 'norm'};
const HEADINGS = [t('Run'), t('Item (serial number)'), t('Model'), t('Begun'), t('State'), t('Result'), t('Operator'), t('Measured'), t('Duration'), t('Go on')];
const SORTED = ['name', 'item', 'model', 'created_utc', 'state', 'verdict', 'operator', 'measured', 'duration_s', null];  // Their keys in the data of a run.
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
const FROZEN = 'register:';  // Marks a chart of the register among the items.

export async function fetchJson(path) {
  const response = await fetched(path);
  if (!response.ok) throw new Error((await response.text()).trim() || t`the console answered ${response.status}`);
  return response.json();
}

const encoded = (name) => encodeURIComponent(name);
const day = (utc) => timeElement(utc, 'day');

function clearCharts() {
  while (charts.length) charts.pop().destroy();
}

function say(id, error) {
  byId(id).replaceChildren(element('p', {role: 'alert', class: 'grade-problem'}, said(error.message || String(error), {capital: true})));
}

// The list: the console finds, sorts and counts, and sends one page of it.

let only = {}, sort = '', descending = false, resuming = null, chosen = null;  // chosen: the first of two runs to be compared.
const QUIET_MS = 200;  // Delay from the last key to the request to the console.

// filter: {item: serial number} or {bench: name}: the life of one item or bench; absent: all runs.
export async function showRuns(resume, filter = {}) {
  resuming = resume;
  if (JSON.stringify(filter) !== JSON.stringify(only)) firstRow = 0;
  only = filter;
  byId('run-list').hidden = false;
  byId('run-detail').replaceChildren();
  clearCharts();
  const search = byId('run-search');
  let soon = null;
  drawMeasurements(Object.keys(filter).length > 0);
  search.oninput = () => { firstRow = 0; clearTimeout(soon); soon = setTimeout(fetchPage, QUIET_MS); };
  await fetchPage();
}

let asked = 0;
async function fetchPage() {
  const number = ++asked;
  let page;
  try {
    page = await fetchJson(`/runs?${new URLSearchParams({...only, search: byId('run-search').value, sort, descending: descending ? 1 : 0, from: firstRow, count: ROWS})}`);
  } catch (error) {
    return say('run-table', error);
  }
  if (number !== asked) return;  // Something else was typed meanwhile.
  if (firstRow && firstRow >= page.found) {
    firstRow = 0;
    return fetchPage();
  }
  // Many runs are read in steps; those already read are shown meanwhile.
  byId('run-loading').textContent = page.unread ? t`Reading: ${page.unread} of ${page.all} runs are still to come.` : '';
  if (page.unread) setTimeout(() => { if (/^#(runs|life\/.*)$/.test(location.hash)) fetchPage(); }, 200);
  drawList(page);
}

// Marks a run of simulated instruments, so that nobody takes it for a calibration.
export function simulatedMark(run) {
  return element('strong', {class: 'simulated', title: t`Simulated: ${rolesIn(run.simulated)}`}, t('SIMULATED'));
}

function drawList(page) {
  const {runs: shown, found, all} = page;
  const resume = resuming;
  byId('run-count').textContent = t`${found} of ${all} runs` + (shown.length < found ? t`; here ${firstRow + 1} to ${firstRow + shown.length}` : '');
  drawLife(page);
  drawPages(found);
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
    if (measured && run.items.some(({dropped}) => dropped === null)) actions.append(compareButton(run));
    const cell = (i, ...content) => element('td', {'data-heading': HEADINGS[i]}, ...content);
    return element('tr', {},
      element('th', {scope: 'row'}, run.state === 'unreadable' ? run.name : link),
      cell(1, run.item || DASH),
      cell(2, [run.maker, run.model].filter(Boolean).join(' ') || DASH),
      cell(3, day(run.created_utc)),
      cell(4, element('span', {}, ...(run.simulated ? [simulatedMark(run), ' '] : []), run.why ? `${STATES[run.state]}: ${run.why}` : `${STATES[run.state] || run.state}${measured && run.analysed === false ? t(', not analysed') : ''}`)),
      cell(5, verdictMark(run.verdict)),
      cell(6, operatorIn(run.operator) || DASH),
      cell(7, run.planned ? t`${run.measured} of ${run.planned} angles` : DASH),
      cell(8, duration(run.duration_s)),
      actions);
  };
  // The first press chooses a run, the second one another to compare it with.
  const compareButton = (run) => {
    const words = chosen === null ? t('Compare') : chosen === run.name ? t('Not this one') : t('With this one');
    const button = element('button', {type: 'button', class: 'compare-run', 'aria-label': `${words}: ${run.name}`}, words);
    button.addEventListener('click', () => {
      if (chosen !== null && chosen !== run.name) {
        location.hash = `#compare/${encoded(chosen)}/${encoded(run.name)}`;
        chosen = null;
      } else {
        chosen = chosen === null ? run.name : null;
        drawList(page);
        document.querySelector(`.compare-run[aria-label$=${JSON.stringify(`: ${run.name}`)}]`)?.focus();
      }
    });
    return button;
  };
  const heading = (words, i) => {
    if (!SORTED[i]) return element('th', {scope: 'col'}, words);
    const isSorted = sort === SORTED[i], button = element('button', {type: 'button', class: 'sort', 'data-sort': SORTED[i]}, words, isSorted ? (descending ? ' ▼' : ' ▲') : '');
    button.addEventListener('click', async () => {
      [sort, descending] = isSorted ? (descending ? ['', false] : [sort, true]) : [SORTED[i], false];
      firstRow = 0;
      await fetchPage();
      document.querySelector(`[data-sort=${SORTED[i]}]`)?.focus();
    });
    return element('th', {scope: 'col', 'aria-sort': isSorted ? (descending ? 'descending' : 'ascending') : false}, button);
  };
  byId('run-table').replaceChildren(element('table', {},
    element('caption', {class: 'visually-hidden'}, t('Runs in the run folder')),
    element('thead', {}, element('tr', {}, ...HEADINGS.map(heading))),
    element('tbody', {}, ...shown.map(row))));
}

const verdictMark = (verdict) => (verdict ? element('span', {class: `mark-${verdict}`}, `${VERDICT_SIGNS[verdict]} ${VERDICTS[verdict]}`) : DASH);

// The measurements of several runs in the folder; of one item or bench they are not known without a look at their runs.
async function drawMeasurements(isLife) {
  const holder = byId('measurement-list');
  let all = [];
  try {
    if (!isLife) all = await fetchJson('/measurements');
  } catch {}  // The list of runs below says that the console does not answer.
  holder.hidden = all.length === 0;
  holder.replaceChildren(element('h3', {id: 'measurement-list-title'}, t('Measurements of several runs')), scrollable('scroll-x stack', t('Measurements of several runs'), table(t('Runs that are evaluated together: abcal combine, abcal mountings.'), [t('Measurement'), t('Made'), t('Runs'), t('Items'), t('Result')],
    all.map((one) => (one.why ? [one.name, DASH, DASH, DASH, said(one.why)] : [element('a', {href: `#measurements/${encoded(one.name)}`}, one.name), day(one.created_utc), one.runs, one.items, element('span', {}, ...(one.simulated ? [simulatedMark(one), ' '] : []), verdictMark(one.verdict))])))));
}

// Shows the results of all runs of one item or bench, with links to its control charts.
function drawLife({found, verdicts, first_utc: first, last_utc: last}) {
  const life = byId('run-life'), [kind] = Object.keys(only), name = only[kind];
  life.hidden = !kind;
  if (!kind) return life.replaceChildren();
  const dl = element('dl', {}), fact = (words, ...content) => dl.append(element('dt', {}, words), element('dd', {}, ...content));
  fact(t('Runs'), found);
  fact(t('Results'), Object.entries(verdicts).map(([verdict, n]) => `${VERDICT_SIGNS[verdict]} ${VERDICTS[verdict]}: ${n}`).join(', ') || DASH);
  if (first) fact(t('First and last run'), day(first), ', ', day(last));
  const charts = PROPERTIES.flatMap((property, i) => [i ? ', ' : '', element('a', {href: `#chart/${encoded(name)}/${property}`}, property)]);
  if (kind === 'item') fact(t('Control charts'), ...charts);
  life.replaceChildren(element('h3', {id: 'run-life-title'}, kind === 'item' ? t`Life of the item ${name}` : t`Life of the bench ${name}`), dl, element('p', {class: 'no-print'}, element('a', {href: '#runs'}, t('All runs'))));
}

function drawPages(found) {
  const go = (words, to) => {
    const button = element('button', {type: 'button', disabled: to < 0 || to >= found}, words);
    button.addEventListener('click', async () => { firstRow = to; await fetchPage(); byId('run-search').focus(); });
    return button;
  };
  byId('run-pages').replaceChildren(...(found > ROWS ? [go(t('Earlier rows'), firstRow - ROWS), go(t('Later rows'), firstRow + ROWS)] : []));
}

// One run.

// Loads the list of runs, or the page of a run that was not complete, again: a state shown may be outdated.
let showAgain = null;
export function statesMayHaveChanged(resume) {
  if (/^#(runs|life\/.*)$/.test(location.hash)) showRuns(resume, only);
  else if (location.hash.startsWith('#runs/')) showAgain?.();
}

// The data of a page in place of the list; none if another view was chosen meanwhile, or if the error is shown.
async function resultOf(kind, name, item) {
  showAgain = null;
  byId('run-list').hidden = true;
  clearCharts();
  try {
    return await askForView(`/${kind}/${encoded(name)}${item ? `/items/${encoded(item)}` : ''}/result`, byId('run-detail'), t`Reading and analysing ${name}`);
  } catch (error) {
    return say('run-detail', error);
  }
}

// item: its number; absent: the first that was not left out.
export async function showRun(name, item, part, {again = false} = {}) {
  const data = await resultOf('runs', name, item), detail = byId('run-detail');
  if (!data) return;
  const {run, results} = data;
  if (run.state !== 'complete') showAgain = () => showRun(name, item, '', {again: true});
  // The first result is that of the estimator chosen for the run; the fits of the published protocol show properties of the stage.
  const reported = results[0], abc = results.find((r) => r.estimator === 'abc'), joint = results.find((r) => r.estimator === 'joint');
  const several = run.items.length > 1, path = `/runs/${encoded(run.name)}${several ? `/items/${data.item}` : ''}`;
  const residuals = new Residuals(path, {fits: abc.diagnostics.fits, unit: abc.response_unit, events: data.events, charts});
  detail.replaceChildren(
    element('p', {class: 'bar', id: 'run-head'}, element('a', {href: '#runs', class: 'no-print'}, t('All runs')), element('strong', {id: 'run-name'}, run.name)),
    ...(several ? [resultItems(run, data.item), element('h3', {id: 'run-item'}, t`Result of item ${data.item}`)] : []),
    verdict(reported, run),
    card(t`Result (${ESTIMATORS[reported.estimator]})`, answer(reported, data.dominates)),
    ...(data.certificate ? [card(t('What the certificate states'), certified(data.certificate))] : []),
    downloads(data.downloads, run, several ? data.item : 0),
    certificateCard(run, several ? data.item : 0, () => showRun(name, item, '')),
    ...(reported.diagnostics.flags.length ? [card(t('Flagged angles'), flagged(reported, data.meanings))] : []),
    residuals.element,
    card(t('Checks of the result'), checks(reported, data.meanings)),
    ...(reported.stage_record ? [card(t('Record of the stage'), stageRecord(reported.stage_record))] : []),
    card(t('Estimators side by side'), estimators(results)),
    card(t('Other estimators in words'), element('ul', {}, ...results.slice(1).map((r) => element('li', {}, `${ESTIMATORS[r.estimator]}: ${VERDICTS[r.verdict]}. `, said(r.why))))),
    card(t('Facts'), facts(data)));
  residuals.load({toFlags: part === 'flags'});
  if (abc.diagnostics.closures.length) detail.append(closures(abc));
  detail.append(harmonics(abc));
  if (joint?.motion) detail.append(card(t('Response at each rate'), motionCard(joint.motion, charts)));
  if (joint && joint.step_error) detail.append(stepErrors(joint));
  detail.append(card(t('Events'), scrollable('scroll', t('Events of the run'), table(t('Events of the run'), [t('Time'), t('Kind'), t('Event')],
    data.events.map((e) => [day(e.utc), term(e.kind), said(e.text)])))));
  if (!again) byId('main').focus({preventScroll: part === 'certificate'});
  if (part === 'certificate') byId('certificate-title').scrollIntoView();
}

// A measurement of several runs: its joint result, and each run with what it states alone. item: from 1; absent: the first.
export async function showMeasurement(name, item) {
  const data = await resultOf('measurements', name, item);
  if (!data) return;
  const {measurement, results: [result]} = data, {runs} = measurement;
  const whole = {name: measurement.name, state: 'complete', simulated: runs.find(({simulated}) => simulated)?.simulated};
  const several = measurement.items > 1;
  const others = Array.from({length: several ? measurement.items : 0}, (_, k) => [k ? ', ' : '', element('a', {href: `#measurements/${encoded(name)}/${k + 1}`, 'aria-current': k + 1 === data.item ? 'page' : false}, t`item ${k + 1}`)]).flat();
  byId('run-detail').replaceChildren(
    element('p', {class: 'bar', id: 'run-head'}, element('a', {href: '#runs', class: 'no-print'}, t('All runs')), element('strong', {id: 'run-name'}, measurement.name), element('span', {}, ...others)),
    verdict(result, whole),
    card(several ? t`Joint result of item ${data.item}` : t('Joint result of all runs'), answer(result, data.dominates)),
    ...(data.certificate ? [card(t('What the certificate states'), certified(data.certificate))] : []),
    downloads(data.downloads, whole, several ? data.item : 0, 'measurements'),
    card(t('Runs'), membersOf(runs, result.series ?? [])),
    ...(result.diagnostics.checks.length ? [card(t('Checks of the result'), checks(result, data.meanings))] : []),
    ...(result.stage_record ? [card(t('Record of the stage'), stageRecord(result.stage_record))] : []));
  byId('main').focus({preventScroll: true});
}

// Each run of a measurement: how the item stood, and how far its results alone are from the joint one.
function membersOf(runs, series) {
  const apart = ({alone}, estimator) => (alone?.[estimator] ? `${alone[estimator].largest_difference_in_u.toFixed(1)} u (${alone[estimator].output})` : DASH);
  const made = table(t('How far the results of each run alone are from the joint one: the largest difference of s, phi and O.'), [t('Run'), t('Begun'), t('Operator'), t('Mounting'), t('Alone'), 'ABC', 'norm', 'joint'],
    runs.map((run, i) => [run.is_here ? element('a', {href: `#runs/${encoded(run.name)}`}, run.name) : run.name, day(run.created_utc), operatorIn(run.operator) || DASH, series[i]?.mounting ?? DASH,
      verdictMark(series[i]?.verdict_alone), ...['abc', 'norm', 'joint'].map((estimator) => (series[i] ? apart(series[i], estimator) : DASH))]));
  made.id = 'measurement-runs';
  return scrollable('scroll-x', t('Runs'), made);
}

const card = (title, content) => element('section', {class: 'card block'}, element('h3', {}, title), content);

export function verdict(result, run) {
  // Long reasons are scrolled.
  return element('div', {class: `verdict verdict-${result.verdict}`, id: 'verdict', tabindex: 0, role: 'group', 'aria-label': t('Result')},
    element('p', {class: 'verdict-word'}, element('span', {class: 'verdict-sign', 'aria-hidden': 'true'}, VERDICT_SIGNS[result.verdict]), element('strong', {}, VERDICTS[result.verdict])),
    element('p', {}, ...(run.simulated ? [simulatedMark(run), t` Simulated: ${rolesIn(run.simulated)}. These are no measurements. `] : []),
      element('span', {class: 'verdict-why'}, said(result.why)),
      run.state === 'complete' ? '' : t` The run is ${STATES[run.state]}: ${run.measured} of ${run.planned} angles are measured.`));
}

// A table of the checks: the failed ones first, with the reason; each with its meaning.
function checks(result, meanings) {
  const all = [...result.diagnostics.checks].sort((a, b) => a.passed - b.passed);
  if (!all.length) return element('p', {}, t('Nothing was checked: the result has too few angles.'));
  const figure = (value, against) => (value === null ? DASH : number(value, Math.min(9, decimals(Math.abs(value) < 1e-3 * against ? 1e-3 * against : value))).replace('-', '−'));
  const outcome = (c) => element('span', {class: c.passed ? 'grade-good' : 'grade-problem'}, c.found === null && c.passed ? t('not made') : c.passed ? t('passed') : t('FAILED'));
  const HEAD = [t('Check'), t('Outcome'), t('Found'), t('Limit'), t('Unit'), t('Meaning')];
  const failed = all.filter((c) => !c.passed), passed = all.filter((c) => c.passed);
  const tableOf = (caption, list) => scrollable('stack scroll-x', caption, table(caption, HEAD,
    list.map((c) => [said(c.check), outcome(c), figure(c.found, c.limit), figure(c.limit, c.limit), term(c.unit),
      element('span', {}, term(meanings[c.check]), ...(c.words ? [' ', element('strong', {}, said(c.words, {capital: true}), '.')] : []))])));
  const words = failed.length ? t`${failed.length} of ${all.length} checks failed.` : t`All ${all.length} checks passed. On a sound bench each fails about once in a million runs.`;
  return element('div', {id: 'result-checks'}, ...(failed.length ? [tableOf(words, failed)] : [element('p', {}, words)]),
    element('details', {id: 'passed-checks'}, element('summary', {}, t`Checks that passed: ${passed.length}`), tableOf(t('Checks that passed'), passed)));
}

// Age and health of the record from which the result takes the stage: the parts of the stage that this run tested.
function stageRecord(record) {
  const outcome = (passed) => element('span', {class: passed ? 'grade-good' : 'grade-problem'}, passed ? t('agrees') : t('CONTRADICTS'));
  const figure = (value, words) => (value === null ? DASH : words(value));
  const made = scrollable('stack scroll-x', t('Record of the stage'), table(
    t`${record.stage}: learned ${record.learned_utc.slice(0, 10)} from ${record.runs} runs; ${record.age_months.toFixed(1)} months old, good for ${record.validity_months.toFixed(1)}.`,
    [t('Part of the stage'), t('Outcome'), t('Times what the record expects'), t('Probability')],
    record.tests.map((one) => [term(one.part), outcome(one.passed), figure(one.times_expected, (x) => x.toFixed(2)), figure(one.probability, (p) => p.toPrecision(2))])));
  made.id = 'result-stage-record';
  return made;
}

function flagged(result, meanings) {
  const {flags, angles_used: used} = result.diagnostics;
  const made = scrollable('stack scroll-x', t('Flagged angles'), table(t`Of ${used} angles used; an angle may have several flags.`,
    [t('Flag'), t('Angles'), t('Meaning')], flags.map((f) => [term(f.flag), f.dwells, term(meanings[f.flag])])));
  made.id = 'result-flags';
  return made;
}

// item: its number; 0: the run has one item. from: the first word of the path.
export function downloads(kinds, run, item, from = 'runs') {
  const bar = element('p', {class: 'bar'}, t('Download:')), making = element('div', {class: 'bar'});
  for (const {name, words} of kinds || []) {
    const link = element('a', {class: 'button', href: `/${from}/${encoded(run.name)}${item ? `/items/${item}` : ''}/${name}`,
      download: `${run.name.replace(/\.(run|measurement)$/, '')}${item ? `-item-${item}` : ''}-${name}`}, t(words));
    bar.append(name.endsWith('.pdf') ? savesPatiently(link, making) : link);
  }
  return element('div', {}, bar, making);
}

// The outputs of a result by their symbols.
function quantities(result) {
  const outputs = result.quantities.filter(({kind}) => kind === 'output');
  return new Map(outputs.flatMap((group) => valuesOf(result, group).map((q, i) => [group.symbols[i], q])));
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
  const fact = (name, ...value) => dl.append(element('dt', {}, name), element('dd', {}, ...(value[0] ? value : [DASH])));
  const {run, timing} = data;
  const life = (kind, name) => element('a', {href: `#life/${kind}/${encoded(name)}`}, name);
  const serials = run.items.map(({serial_number: serial}) => serial).filter(Boolean);
  fact(t('Item (serial number)'), ...(serials.length ? serials.flatMap((serial, i) => [...(i ? [', '] : []), life('item', serial)]) : [run.item || DASH]));
  for (const i of run.items.length > 1 ? run.items : []) fact(t`Item ${i.k}`, i.dropped ? t`${i.model} ${i.serial_number}, left out: ${i.dropped}` : t`${i.model} ${i.serial_number}, ${i.measured} angles`);
  fact(t('Bench'), run.bench ? life('bench', run.bench) : DASH);
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
  const rows = result.diagnostics.closures, holder = place(), names = [...new Set(rows.map((c) => c.name))], unit = result.response_unit;
  const block = card(t('Closures: zero for a perfect stage'), element('div', {}, holder,
    element('details', {}, element('summary', {}, t('As a table')), table(t`Closures and their standard uncertainty (${unit})`,
      [t('Closure'), t('Output'), t`Value (${unit})`, t`std. uncertainty (${unit})`, t('Ratio (1)')],
      rows.map((c) => [c.name, c.accelerometer, small(c.value.value), small(c.value.standard_uncertainty), signed(c.value.value / c.value.standard_uncertainty, 2)])))));
  const column = (read) => OUTPUTS.map((output) => names.map((name) => { const found = rows.find((c) => c.name === name && c.accelerometer === output); return found ? read(found.value) : null; }));
  queueMicrotask(() => charts.push(overNames(holder, {name: t('Closures with bars of ±2 u; the table has the numbers'), x: t('closure'), y: t`closure ± 2 u (${unit})`, names, unit,
    values: column(({value}) => value), us: column(({standard_uncertainty: u}) => u)})));
  return block;
}

function harmonics(result) {
  const rows = [];
  for (const fit of result.diagnostics.fits) {
    for (const h of fit.harmonics.filter((x) => x.order >= 2)) {
      rows.push({label: `${fit.experiment}, ${h.order}`, experiment: fit.experiment, output: fit.accelerometer, order: h.order,
        amplitude: Math.hypot(h.sin.value, h.cos.value), u: Math.hypot(h.sin.standard_uncertainty, h.cos.standard_uncertainty) / Math.SQRT2});
    }
  }
  if (!rows.length) return card(t('Harmonics'), element('p', {}, t('These angles do not determine harmonics.')));
  const unit = result.response_unit, holder = place(), names = [...new Set(rows.map((r) => r.label))];
  const block = card(t('Harmonics 2 to 5 of the response'), element('div', {}, holder,
    element('details', {}, element('summary', {}, t('As a table')), table(t`Amplitudes (${unit})`,
      [t('Experiment'), t('Order (1)'), t('Output'), t`Amplitude (${unit})`, t`std. uncertainty of a coefficient (${unit})`],
      rows.map((r) => [r.experiment, r.order, r.output, small(r.amplitude), small(r.u)])))));
  const column = (read) => OUTPUTS.map((output) => names.map((label) => { const found = rows.find((r) => r.label === label && r.output === output); return found ? read(found) : null; }));
  queueMicrotask(() => charts.push(overNames(holder, {name: t('Amplitudes of the harmonics 2 to 5 with bars of ±2 u; the table has the numbers'), x: t('experiment, order of the harmonic'), y: t`amplitude ± 2 u (${unit})`, names, unit,
    values: column(({amplitude}) => amplitude), us: column(({u}) => u)})));
  return block;
}

function stepErrors(joint) {
  const holder = element('div', {class: 'plots'});
  const rows = [];
  joint.step_error.forEach((errors, i) => {
    const one = place();
    holder.append(element('div', {}, element('h4', {}, t`Experiment ${i + 1}: axis ${i === 2 ? 'Z' : 'X'}`), one));
    const points = errors.map((q, k) => ({n: k + 1, ...q})).filter((q) => q.value !== null);
    for (const p of points) rows.push([i + 1, p.n, signed(p.value, 5), number(p.standard_uncertainty, 5)]);
    queueMicrotask(() => {
      const chart = new Chart(one, {name: t`Step errors of experiment ${i + 1}; the table has the numbers`, x: {words: t('number n of the angle (1)')}, y: t('step error (degrees)'), sync: 'step errors',
        series: [{output: OUTPUTS[i], label: t('step error'), points: true, line: true, dash: []}]});
      chart.unit = '°';
      chart.show(points.map(({n}) => n), [points.map(({value}) => value)], {bars: [points.map(({standard_uncertainty: u}) => u)]});
      charts.push(chart);
    });
  });
  const pages = scrollable('scroll', t('Step errors (degrees)'), '');
  new PagedTable(pages, {caption: () => t('Step errors (degrees)'), rows: (from, to) => rows.slice(from, to),
    head: () => [t('Experiment'), 'n', t('Step error (degrees)'), t('std. uncertainty (degrees)')]}).show(rows.length);
  return card(t('Step errors of the stage, from the joint estimator'), element('div', {},
    element('p', {}, t('Points: estimated error of each commanded angle; bars: ±2 u.')), holder,
    element('details', {}, element('summary', {}, t('As a table')), pages)));
}

// Two runs.

const CHOICES = 200;  // Runs in the choice of two to compare, the newest; others are chosen in the list of runs.

export async function showCompare(first, second) {
  clearCharts();
  const byName = (name) => fetchJson(`/runs?${new URLSearchParams({search: name.replace(/#\d+$/, ''), state: 'complete', count: 20})}`);
  try {
    const pages = await Promise.all([fetchJson(`/runs?state=complete&count=${CHOICES}`), ...[first, second].filter(Boolean).map(byName)]);
    list = [...new Map(pages.flatMap(({runs}) => runs).map((run) => [run.name, run])).values()];
  } catch (error) {
    return say('compare-table', error);
  }
  const usable = list;
  // The items of a run with several are listed singly: NAME#K.
  const choices = usable.flatMap((run) => run.items.filter(({dropped}) => dropped === null).map(({k, serial_number: serial}) => ({run, serial, name: run.items.length > 1 ? `${run.name}#${k}` : run.name})));
  const fill = (id, chosen) => byId(id).replaceChildren(...choices.map(({run, serial, name}) => element('option', {value: name, selected: name === chosen}, `${name} (${serial || t('no serial number')})${run.simulated ? ` ${t('SIMULATED')}` : ''}`)));
  fill('compare-a', first || choices[1]?.name);
  fill('compare-b', second || choices[0]?.name);
  byId('compare-form').onsubmit = (event) => {
    event.preventDefault();
    const address = `#compare/${encoded(byId('compare-a').value)}/${encoded(byId('compare-b').value)}`;  // It can be sent to others.
    if (location.hash === address) compare(byId('compare-a').value, byId('compare-b').value); else location.hash = address;
  };
  byId('compare-form').querySelector('button').disabled = choices.length < 2;
  if (choices.length < 2) byId('compare-table').replaceChildren(element('p', {}, t('Two complete runs are needed.')));
  else if (first && second) compare(byId('compare-a').value, byId('compare-b').value);
}

async function compare(a, b) {
  let data;
  try {
    data = await fetchJson(`/compare/${encoded(a)}/${encoded(b)}${byId('compare-shared').checked ? '/shared-stage' : ''}`);
  } catch (error) {
    return say('compare-table', error);
  }
  const [pair] = data.pairs, named = (name, {estimator}) => (estimator ? `${name} (${ESTIMATORS[estimator]})` : name);
  const row = (name) => {
    const first = data.results[0].properties[name], second = data.results[1].properties[name], both = pair.properties[name];
    return [name, first.unit, ...[first, second].flatMap((q) => [signed(q.value, decimals(q.standard_uncertainty)), small(q.standard_uncertainty)]),
      signed(both.difference, decimals(both.standard_uncertainty)), small(both.standard_uncertainty), signed(both.e_n, 2)];
  };
  const holder = place(), inOrder = (read) => OUTPUTS.map((_, j) => [0, 3, 6].map((first) => read(pair.properties[PROPERTIES[first + j]])));
  clearCharts();
  queueMicrotask(() => charts.push(overNames(holder, {name: t('E_n of the nine properties with bars of U; the table has the numbers'), x: t('property: u, v, w from left to right'), y: t('E_n: difference over its U (1)'),
    names: [t('sensitivity'), t('angle'), t('offset')], values: inOrder(({e_n: ratio}) => ratio), us: inOrder(() => 0.5), unit: '1',
    levels: [{y: 0, words: '', dash: []}, {y: 1, words: t('limits'), dash: [8, 4]}, {y: -1, words: '', dash: [8, 4]}]})));
  const simulated = list.filter((run) => run.simulated && [a, b].some((name) => name === run.name || name.startsWith(`${run.name}#`)));
  byId('compare-table').replaceChildren(
    element('p', {id: 'compare-words', role: 'status'}, ...simulated.flatMap((run) => [simulatedMark(run), t` ${run.name} is simulated: no measurement. `]), said(pair.why)),
    element('h3', {}, t('E_n: a bar that does not reach zero is a difference larger than its U')), holder,
    scrollable('scroll-x', `A: ${a}. B: ${b}.`, table(t`Properties that do not depend on mounting; E_n with U = 2 u. A: ${named(a, data.results[0])}. B: ${named(b, data.results[1])}.`,
      [t('Property'), t('Unit'), 'A', t('std. unc. of A'), 'B', t('std. unc. of B'), t('B minus A'), t('std. unc. of it'), 'E_n (1)'], PROPERTIES.map(row))),
    element('ul', {}, ...data.notes.map((note) => element('li', {}, said(note)))));
}

// The control chart.

export async function showChart(serial, property = PROPERTIES[0]) {
  clearCharts();
  try {
    list = await fetchJson('/runs');
  } catch (error) {
    return say('chart-body', error);
  }
  const measured = (run) => run.items.filter((item) => item.dropped === null).map((item) => item.serial_number);
  const items = [...new Set(list.filter((run) => run.state === 'complete').flatMap(measured).filter(Boolean))].sort();
  // Charts of the register are distinguished from the items of the folder by their group.
  const frozen = await fetched('/check-charts').then((response) => (response.ok ? response.json() : []), () => []);
  const group = (words, options) => (options.length ? [element('optgroup', {label: words}, ...options)] : []);
  byId('chart-item').replaceChildren(...group(t('Approved baselines of the register'), frozen.map(({name}) => element('option', {value: `${FROZEN}${name}`, selected: `${FROZEN}${name}` === serial}, name))),
    ...group(t('Items with runs in this folder'), items.map((item) => element('option', {value: item, selected: item === serial || (!serial && item === items[0])}, item))));
  byId('chart-property').replaceChildren(...PROPERTIES.map((p) => element('option', {value: p, selected: p === property}, inWords(p))));
  byId('chart-form').onchange = () => drawChart(byId('chart-item').value, byId('chart-property').value);
  byId('chart-form').onsubmit = (event) => {
    event.preventDefault();
    drawChart(byId('chart-item').value, byId('chart-property').value);
  };
  byId('chart-form').querySelector('button').disabled = items.length + frozen.length === 0;
  if (!items.length && !frozen.length) byId('chart-body').replaceChildren(element('p', {}, t('No complete run of an item with a serial number exists yet.')));
  else drawChart(byId('chart-item').value, byId('chart-property').value);
}

// Places of the numbers of `count` runs on an axis, at most about eight.
const numbersOf = (count) => (min, max) => {
  const each = Math.max(1, Math.ceil((max - min) / 8));
  return Array.from({length: count}, (_, i) => i + 1).filter((x) => x >= min && x <= max && (x - 1) % each === 0);
};

let drawing = 0;  // Number of the chart that was asked for last: an answer to an earlier request draws nothing.

// The frozen baseline of a check standard, and later runs judged by it.
async function drawFrozen(name, property) {
  const own = ++drawing;
  let data;
  try {
    data = await fetchJson(`/check-charts/${encoded(name)}`);
  } catch (error) {
    return say('chart-body', error);
  }
  if (own !== drawing) return;
  clearCharts();
  const {baseline, points: later} = data, unit = data.units[PROPERTIES.indexOf(property)], centre = baseline.centre[property], sd = baseline.standard_deviation[property], edge = baseline.rules.shewhart * sd;
  const rows = [...baseline.runs.map(({date, values}) => ({date, value: values[property], judged: null})), ...later.map(({date, properties}) => ({date, value: properties[property].value, judged: properties[property]}))];
  const digits = decimals(sd), holder = place(), broken = (one) => (one === null ? t('baseline') : one.outside ? element('span', {class: 'grade-problem'}, t('OUTSIDE'), ': ', said(one.broken)) : t('inside'));
  const words = t`Approved by ${data.approved_by}: centre ${number(centre, digits)} ${unit}; single values within ${number(centre - edge, digits)} to ${number(centre + edge, digits)} ${unit}. ` + (data.blocked ? t('The bench is blocked. ') : '')
    + (data.waiting.length ? t`${data.waiting.length} measured runs are not judged yet.` : '');
  byId('chart-body').replaceChildren(element('p', {id: 'chart-words', role: 'status', class: data.blocked ? 'grade-problem' : false}, words), holder,
    scrollable('scroll-x', inWords(property), table(t`${inWords(property)}, of the chart ${name}, oldest first. z and the moving average are in standard deviations of the baseline.`, [t('Run'), t('Begun'), t`Value (${unit})`, 'z (1)', t('Moving average (1)'), t('Limits')],
      rows.map(({date, value, judged}, i) => [i + 1, day(date), signed(value, digits), signed((value - centre) / sd, 1), judged ? signed(judged.ewma, 1) : DASH, broken(judged)]))));
  const chart = new Chart(holder, {name: t`Control chart of ${inWords(property)}; the table has the numbers`, y: `${property} (${unit})`, series: [{output: 'u', label: t('value'), points: true, line: true, dash: []}],
    x: {words: t('number of the run'), whole: [0.5, rows.length + 0.5], splits: numbersOf(rows.length), say: (x) => `${x}: ${rows[x - 1] ? timeText(rows[x - 1].date, 'date') : ''}`}});
  chart.unit = unit;
  chart.show(rows.map((_, i) => i + 1), [rows.map(({value}) => value)], {bars: [rows.map(() => sd)], rings: rows.flatMap(({judged}, i) => (judged?.outside ? [i] : [])),
    marks: [{x: baseline.runs.length + 0.5}], levels: [{y: centre, words: t('centre'), dash: []}, {y: centre + edge, words: t('limits'), dash: [8, 4]}, {y: centre - edge, words: '', dash: [8, 4]}]});
  charts.push(chart);
}

async function drawChart(serial, property) {
  if (serial.startsWith(FROZEN)) return drawFrozen(serial.slice(FROZEN.length), property);
  const own = ++drawing;
  let data;
  try {
    data = await fetchJson(`/history/${encoded(serial)}/${property}`);
  } catch (error) {
    return say('chart-body', error);
  }
  if (own !== drawing) return;
  clearCharts();
  const points = data.runs.map((run, i) => ({run, x: i + 1, value: run.value, standard_uncertainty: run.standard_uncertainty, unit: run.unit})).filter((p) => p.value !== null);
  const limits = data.limits;
  const unit = points[0]?.unit || '1';
  const holder = place();
  const words = limits
    ? t`Centre ${number(limits.centre, decimals(limits.standard_deviation))} ${unit}; limits ${number(limits.lower, decimals(limits.standard_deviation))} to ${number(limits.upper, decimals(limits.standard_deviation))} ${unit} (3 standard deviations from the mean moving range). ` + (limits.outside ? t`${limits.outside} outside.` : t('All inside.'))
    : t('Limits need at least two runs.');
  byId('chart-body').replaceChildren(
    element('p', {id: 'chart-words', role: 'status'}, words),
    holder,
    scrollable('scroll-x', inWords(property), table(t`${inWords(property)}, of item ${serial}, oldest first`, [t('Run'), t('Begun'), t`Value (${unit})`, t`std. uncertainty (${unit})`, t('Limits'), t('Verdict')],
      points.map((p) => [element('a', {href: `#runs/${encoded(p.run.name)}${p.run.item ? `/${p.run.item}` : ''}`}, `${p.x}: ${p.run.name}`), day(p.run.created_utc),
        signed(p.value, decimals(p.standard_uncertainty)), small(p.standard_uncertainty), against(limits, p.value), p.run.simulated ? simulatedMark(p.run) : VERDICTS[p.run.verdict]]))));
  const chart = new Chart(holder, {name: t`Control chart of ${inWords(property)}; the table has the numbers`, y: `${property} (${unit})`,
    series: [{output: 'u', label: t('value'), points: true, line: true, dash: []}],
    x: {words: t('number and day of the run'), whole: [0.5, points.length + 0.5], say: (x) => `${x}: ${points[x - 1]?.run.name ?? ''}`,
      splits: numbersOf(points.length),
      values: (_, splits) => splits.map((x) => (points[x - 1] ? `${x}\n${timeText(points[x - 1].run.created_utc, 'date')}` : ''))},
    picked: (i) => { location.hash = `#runs/${encoded(points[i].run.name)}${points[i].run.item ? `/${points[i].run.item}` : ''}`; }});
  chart.unit = unit;
  chart.show(points.map(({x}) => x), [points.map(({value}) => value)], {bars: [points.map((p) => p.standard_uncertainty)],
    rings: points.flatMap((p, i) => (limits && (p.value < limits.lower || p.value > limits.upper) ? [i] : [])),
    levels: limits ? [{y: limits.centre, words: t('centre'), dash: []}, {y: limits.upper, words: t('limits'), dash: [8, 4]}, {y: limits.lower, words: '', dash: [8, 4]}] : []});
  charts.push(chart);
}

function against(limits, value) {
  if (!limits) return DASH;
  return value < limits.lower || value > limits.upper ? element('span', {class: 'grade-problem'}, t('OUTSIDE')) : t('inside');
}
