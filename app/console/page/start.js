// The start form: item, operator, plan, predictions, and warnings before the start. It is shown in the dialog that asks whether to
// start, and contains nothing that the console has not stated.
import {duration, element, small, DASH} from '/text.js';
import {said} from '/said.js';
import {fetched} from '/fetched.js';
import {withoutMissing} from '/items.js';
import {operatorIn, rolesIn, t} from '/language.js';
import {timeElement} from '/time.js';

// The texts without values.
const TEXT = {
  choose: t('From the register, or type or scan its serial number'), typed: t('as typed below'),
  serial: t('Serial number'), model: t('Model'), maker: t('Maker'), customer: t`Customer's number`,
  steps: t('Angles of each experiment'), readings: t('Readings at each angle'), estimator: t('Estimator of the result'), runs: t('Runs of this item, without mounting it anew'), noSerial: t('An item of the queue has a serial number: type or scan it.'),
  bench: t('Bench'), operator: t('Operator'), nobody: t('nobody'),
  time: t('Predicted duration'), plusMoves: t('plus the moves: the bench file gives no speed'),
  uncertainty: t('Predicted standard uncertainties'), noNoise: t('not known: there is no earlier run of this item or model'), noPrediction: t('not predicted for this estimator'),
  noise: t('Noise of a reading'), disk: t('Free disk space'), check: t('Last check of this bench'), record: t('Record of the stage'), never: t('none from the console'),
  noMotion: t('without motion'), before: t('Before the start'), refused: t('It cannot be started'),
  items: t('Items of the bench file'),
  reading: t('Reading the bench file, predicting'), asBench: t('as the bench file'),
};
const SYMBOLS = {s: t('s (sensitivity, relative)'), off: t('off-diagonal, relative to s'), O: t('O (offset), relative to s'), phi: t('phi (angles between the outputs)')};
const QUIET_MS = 300;  // Delay from the last key to the request to the console.

const megabytes = (bytes) => (bytes === null ? DASH : bytes > 1e10 ? `${(bytes / 1e9).toFixed(0)} GB` : `${(bytes / 1e6).toFixed(0)} MB`);
// "1.2e-5": two significant digits, however small.
const scientific = (value, unit) => (value === null ? DASH : `${value >= 0.01 ? small(value) : value.toExponential(1).replace('-', '−')}${unit ? ` ${unit}` : ''}`);

const TOO_MANY = 429, AGAIN_MS = 500;

// The run that would be started, with `fields` in place of the bench file's own: the answer of the console, which without a `plan`
// gives the reasons in `problems`. If newer questions of this person took its place (another page, or a form that is open), it is
// asked again. signal: withdraws the question.
export async function startFormAnswer(fields = {}, signal = undefined) {
  const chosen = new URLSearchParams(Object.entries(fields).filter(([, value]) => value !== ''));
  try {
    for (;;) {
      const response = await fetched(`/start-form?${chosen}`, {signal});
      if (response.ok) return await response.json();
      const why = (await response.text()).trim();
      if (response.status !== TOO_MANY) return {warnings: [], problems: [why]};
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  } catch (error) {
    return {warnings: [], problems: [String(error.message || error)]};
  }
}

export class StartForm {
  // pace: simulated time over real time; 1 for real instruments. about: initial values of fields, e.g. {runs: 1} for the queue.
  constructor(pace, about = {}) {
    this.pace = pace;
    this.fields = {maker: '', model: '', serial_number: '', customer_number: '', steps: '', dwell_readings: '', estimator: '', ...about};
    this.answer = null;
  }

  // Puts the form into `holder`. The button `yes` is enabled when the console has answered and reports no problem.
  open(holder, yes) {
    this.yes = yes;
    yes.disabled = true;
    const input = (name, attributes = {}) => {
      const made = element('input', {id: `start-${name.replace('_', '-')}`, autocomplete: 'off', maxlength: 100, ...attributes});
      made.value = this.fields[name];
      made.addEventListener('input', () => { this.fields[name] = made.value; this.askSoon(); });
      return made;
    };
    const labelled = (words, control) => element('div', {}, element('label', {for: control.id}, words), control);
    const select = (name) => {
      const made = element('select', {id: `start-${name.replace('_', '-')}`});
      made.addEventListener('change', () => { this.fields[name] = made.value; this.ask(); });
      return made;
    };
    this.items = element('select', {id: 'start-item'});
    this.items.addEventListener('change', () => this.chooseItem());
    this.inputs = {serial_number: input('serial_number', {spellcheck: 'false'}), model: input('model'), maker: input('maker'), customer_number: input('customer_number'),
      dwell_readings: input('dwell_readings', {type: 'number', min: 4, max: 1000000, step: 1})};
    if (this.fields.runs) this.inputs.runs = input('runs', {type: 'number', min: 1, max: 100, step: 1});
    this.steps = select('steps');
    this.estimators = select('estimator');
    this.facts = element('dl', {id: 'start-facts'});
    this.state = element('p', {role: 'status', id: 'start-state'}, TEXT.reading);
    this.notices = element('div', {id: 'start-notices', role: 'status'});
    // A single item is chosen here. Several items are those of the bench file; a person chooses whether missing ones are left out.
    this.oneItem = [labelled(TEXT.choose, this.items), labelled(TEXT.serial, this.inputs.serial_number), labelled(TEXT.customer, this.inputs.customer_number),
      labelled(TEXT.maker, this.inputs.maker), labelled(TEXT.model, this.inputs.model)];
    this.withoutMissing = withoutMissing('start-without-missing');
    this.severalItems = element('div', {id: 'start-items', hidden: true});
    this.holder = element('div', {class: 'start-form'}, this.severalItems,
      this.oneItem[0],
      element('div', {class: 'pair'}, ...this.oneItem.slice(1),
        labelled(TEXT.steps, this.steps), labelled(TEXT.readings, this.inputs.dwell_readings), labelled(TEXT.estimator, this.estimators), ...(this.inputs.runs ? [labelled(TEXT.runs, this.inputs.runs)] : [])),
      this.state, this.notices, this.facts);
    holder.replaceChildren(this.holder);
    // A scanner types a text and Enter wherever the focus is; its Enter neither starts nor cancels anything.
    const dialog = holder.closest('dialog');
    this.scan = (event) => {
      if (event.ctrlKey || event.altKey || event.metaKey || event.isComposing) return;
      const at = document.activeElement;
      if (event.key === 'Enter' && (at.tagName === 'INPUT' || at.tagName === 'SELECT')) {
        event.preventDefault();
        if (at === this.inputs.serial_number) this.entered();
      } else if (event.key.length === 1 && event.key !== ' ' && !['INPUT', 'SELECT'].includes(at.tagName)) {
        this.inputs.serial_number.focus();
        this.inputs.serial_number.select();
      }
    };
    dialog.addEventListener('keydown', this.scan);
    dialog.addEventListener('close', () => { dialog.removeEventListener('keydown', this.scan); this.withdraw(); }, {once: true});
    this.ask();
  }

  // A serial number is complete: the data of the register on it are taken.
  entered() {
    const serial = this.fields.serial_number.trim();
    const known = (this.answer?.register?.items ?? []).find((item) => item.serial_number === serial);
    if (known) this.take(known);
    else this.set('serial_number', serial);
    this.inputs.serial_number.select();
    this.ask();
  }

  set(name, value) {
    this.fields[name] = value;
    if (this.inputs[name]) this.inputs[name].value = value;
  }

  take(item) {
    if (item.serial_number !== this.answer?.item?.serial_number) this.set('customer_number', '');
    for (const name of ['maker', 'model', 'serial_number']) this.set(name, item[name]);
  }

  chooseItem() {
    const item = this.answer?.register?.items[Number(this.items.value)];
    if (this.items.value !== '' && item) this.take(item);
    this.ask();
  }

  // An answer to an earlier state of the form must not enable the button: it would start a run without what was typed since.
  askSoon() {
    this.withdraw();
    this.soon = setTimeout(() => this.ask(), QUIET_MS);
  }

  // Drops the question that waits for its answer. @return what withdraws the next one
  withdraw() {
    clearTimeout(this.soon);
    this.question?.abort();
    this.question = new AbortController();
    this.yes.disabled = true;
    return this.question.signal;
  }

  async ask() {
    const withdrawn = this.withdraw();
    this.state.textContent = TEXT.reading;
    const first = this.answer === null, {serial_number: serial, ...others} = this.fields;
    const {runs, ...fields} = serial ? this.fields : {...others, maker: '', model: '', customer_number: ''};  // No serial number: the item of the bench file.
    const answer = await startFormAnswer(fields, withdrawn);
    if (withdrawn.aborted) return;  // Something else was typed meanwhile, or the form is closed.
    this.state.textContent = '';
    if (first && answer.item) {
      for (const name of ['maker', 'model', 'serial_number', 'customer_number']) this.set(name, answer.item[name]);
      this.set('dwell_readings', String(answer.plan?.dwell_readings ?? ''));
    }
    this.answer = answer.item ? answer : {...this.answer, problems: answer.problems};
    if (runs && answer.item && !answer.item.serial_number) answer.problems.push(TEXT.noSerial);
    this.show(answer);
    this.yes.disabled = answer.problems.length > 0;
  }

  show(answer) {
    const list = (title, kind, lines) => (lines.length ? [element('h3', {}, title), element('ul', {class: `grade-${kind}`}, ...lines.map((line) => element('li', {}, line === TEXT.noSerial ? line : said(line))))] : []);
    this.notices.replaceChildren(...list(TEXT.refused, 'problem', answer.problems), ...list(TEXT.before, 'warning', answer.warnings));
    this.facts.hidden = !answer.plan;
    if (answer.items) this.showItems(answer.items);
    if (!answer.plan) return;
    const option = (value, words, selected) => element('option', {value, selected}, words);
    const items = answer.register?.items ?? [];
    const at = items.findIndex((item) => item.serial_number === answer.item.serial_number && item.model === answer.item.model);
    this.items.replaceChildren(option('', TEXT.typed, at < 0), ...items.map((item, i) => option(i, `${item.identity}${item.owner ? ` (${item.owner})` : ''}`, i === at)));
    this.items.disabled = items.length === 0;
    const {plan, as_bench_file: asBench} = answer;
    const choices = [...new Set([asBench.steps, ...plan.step_choices, plan.steps])].sort((a, b) => a - b);
    this.steps.replaceChildren(...choices.map((n) => option(n, `${n}${n === asBench.steps ? ` (${TEXT.asBench})` : ''}`, n === plan.steps)));
    this.estimators.replaceChildren(...answer.estimators.map((name) => option(name, `${name}${name === asBench.estimator ? ` (${TEXT.asBench})` : ''}`, name === plan.estimator)));
    this.showFacts(answer);
  }

  showItems(items) {
    const several = items.length > 0;
    for (const part of this.oneItem) part.hidden = several;
    this.severalItems.hidden = !several;
    if (!several || this.severalItems.childElementCount) return;
    this.severalItems.append(element('h3', {}, TEXT.items), element('ol', {}, ...items.map((item) => element('li', {}, [item.maker, item.model, item.serial_number].filter(Boolean).join(' ') || item.driver))),
      this.withoutMissing.label);
  }

  showFacts(answer) {
    const facts = [];
    const fact = (name, ...content) => facts.push(element('dt', {}, name), element('dd', {}, ...content));
    const {operator, duration: time, disk, last_check: check, plan, noise} = answer;
    fact(TEXT.bench, answer.bench || answer.bench_file, ...(answer.simulated ? [' ', element('strong', {class: 'simulated'}, t`SIMULATED: ${rolesIn(answer.simulated)}`)] : []));
    fact(TEXT.operator, !operator.name ? TEXT.nobody : operator.verified ? t`${operator.name} (logged in)` : t`${operator.name} (as the bench file says, not verified)`);
    const total = duration(time.total_s), shown = duration(time.total_s / this.pace);
    fact(TEXT.time, total, time.speeds_known ? '' : `, ${TEXT.plusMoves}`, t`; ${plan.angles} angles`, answer.simulated && this.pace > 1 ? t`; simulated, shown in about ${shown}` : '');
    if (answer.predicted.length) {
      fact(TEXT.uncertainty, element('ul', {}, ...answer.predicted.map((p) => element('li', {},
        `${SYMBOLS[p.symbol]}: ${scientific(p.standard_uncertainty, p.unit)}; `, t('mostly '), said(p.largest_part)))));
      fact(TEXT.noise, scientific(noise.value, 'g_loc'), t(', from '), said(noise.source));
    } else {
      fact(TEXT.uncertainty, plan.estimator === 'norm' ? TEXT.noPrediction : TEXT.noNoise);
    }
    fact(TEXT.disk, t`${megabytes(disk.free_bytes)}, needed ${megabytes(disk.needed_bytes)}`);
    if (check) fact(TEXT.check, timeElement(check.utc, 'day'), t`: ${check.good} good, ${check.warnings} warnings, ${check.problems} problems`, check.with_motion ? '' : `, ${TEXT.noMotion}`, ' (', operatorIn(check.by), ')');
    else fact(TEXT.check, TEXT.never);
    const {stage_record: record} = answer;
    if (record) {
      const {last_run: last} = record;
      fact(TEXT.record, timeElement(record.learned_utc, 'day'), t`: learned from ${record.runs} runs, ${record.age_months.toFixed(1)} months old, good for ${record.validity_months.toFixed(1)}; `,
        last ? element('span', {class: last.agrees ? 'grade-good' : 'grade-problem'}, last.agrees ? t`run ${last.name} agrees with it` : t`run ${last.name} contradicts it`) : t('not yet tested by a run here'));
    }
    this.facts.replaceChildren(...facts);
  }

  // The choice for the request, exactly as the person has seen it.
  choice() {
    const {item, plan, bench_sha256: seen, form} = this.answer;
    const wanted = {steps: plan.steps, dwell_readings: plan.dwell_readings, estimator: plan.estimator, bench_sha256: seen, form};
    if (this.answer.items.length) return {...wanted, ...this.withoutMissing.choice()};
    if (item.serial_number) wanted.item = item;
    return wanted;
  }
}
