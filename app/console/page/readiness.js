// The first screen of a bench at rest: whether it is ready to measure, from the same data as the start form.
import {byId, duration, element, number, DASH} from '/text.js';
import {said} from '/said.js';
import {fetched} from '/fetched.js';
import {startFormAnswer} from '/start.js';
import {operatorIn, t} from '/language.js';

// The texts without values.
const TEXT = {
  instruments: t('Instruments, at the last check'), never: t('not checked from this console yet'), item: t('Loaded item'), several: t('Loaded items'), noItem: t('as the instrument reports'),
  record: t('Record of the stage'), noRecord: t('none is used'), register: t('Register'), noRegister: t('none: no name is verified'), operator: t('Operator'), nobody: t('nobody'),
  disk: t('Disk'), plan: t('Plan'), reading: t('Reading the bench file'), cannot: t('A run cannot be started: '), training: t(' (training)'),
  demo: t('No run is here yet. This bench is simulated: nothing can move, and a run shows all that the console does.'), noRuns: t('No run is here yet. The command "abcal demo" shows a whole calibration without instruments.'),
};
// The mark before a fact: a sign and a colour.
const MARKS = {good: ['✓', t('good')], warning: ['!', t('warning')], problem: ['✗', t('problem')]};
const AGE_MS = 60_000;  // Ages of the page are renewed so often.

// "3 min", "2 h", "5 d": how long ago.
function ageOf(utc) {
  const minutes = Math.max(0, Date.now() - new Date(utc)) / 60_000;
  return minutes < 1 ? t('less than a minute ago') : minutes < 90 ? t`${Math.round(minutes)} min ago` : minutes < 2880 ? t`${Math.round(minutes / 60)} h ago` : t`${Math.round(minutes / 1440)} days ago`;
}

const gigabytes = (bytes) => (bytes === null ? DASH : bytes >= 1e9 ? `${number(bytes / 1e9, 0)} GB` : `${number(bytes / 1e6, 0)} MB`);

export class Readiness {
  // tryIt: starts the way to a first run. loaded: takes the item that is loaded, in words.
  constructor(tryIt, {loaded}) {
    this.loaded = loaded;
    byId('try-demo').addEventListener('click', tryIt);
    this.answer = null;
    this.runs = null;  // Number of runs in the folder.
    this.idle = false;
    setInterval(() => this.show(), AGE_MS);
  }

  // Whether the next step is a check: none is known, it is too old, or it found problems.
  get needsCheck() {
    const check = this.answer?.last_check;
    return this.answer !== null && (!check || check.outdated || check.problems > 0);
  }

  // Whether a first run of a bench that is simulated is the next step.
  get offersDemo() { return this.runs === 0 && Boolean(this.answer?.simulated); }

  receive(message) {
    if (message.type === 'checks' || message.type === 'snapshot') this.ask();
  }

  offer(steer, idle) {
    byId('readiness').hidden = !idle;
    byId('run-card').hidden = idle && byId('run-file').textContent === DASH;
    if (idle && !this.idle) this.ask();
    this.idle = idle;
    this.next();
  }

  async ask() {
    const number = this.asked = (this.asked ?? 0) + 1;
    const answer = await startFormAnswer();
    if (!this.runs) this.runs = await fetched('/runs?count=1').then((response) => response.json(), () => ({all: null})).then(({all}) => all);
    if (number !== this.asked) return;
    this.answer = answer;
    this.show();
  }

  // The next step in words: those of the button that looks so.
  next() {
    byId('try-demo').hidden = !this.offersDemo;
    byId('no-runs').hidden = this.runs !== 0;
    if (this.runs === 0) byId('no-runs').textContent = this.offersDemo ? TEXT.demo : TEXT.noRuns;
    const button = document.querySelector('#steering .next-step, #interrupted .next-step, #try-demo.next-step'), problems = this.answer?.problems ?? [];
    const words = this.answer === null ? [TEXT.reading] : problems.length ? [element('strong', {class: 'grade-problem'}, TEXT.cannot, said(problems[0]))]
      : button ? [t`Next step: ${button.textContent}`] : [DASH];
    const text = words.map((each) => each.textContent ?? each).join('');
    if (byId('next-step').textContent !== text) byId('next-step').replaceChildren(...words);
  }

  show() {
    this.next();
    const {answer} = this;
    if (!answer?.plan) return;
    const facts = [], fact = (grade, name, ...content) => facts.push(element('div', {},
      element('dt', {}, name), element('dd', {class: `grade-${grade}`}, element('span', {'aria-label': MARKS[grade][1], role: 'img'}, MARKS[grade][0]), ' ', ...content)));
    const {last_check: check, stage_record: record, register, operator, disk, items, item, plan, duration: time} = answer;
    if (check) {
      fact(check.problems ? 'problem' : check.warnings || check.outdated ? 'warning' : 'good', TEXT.instruments,
        t`${check.good} good, ${check.warnings} warnings, ${check.problems} problems`, ', ', ageOf(check.utc));
    } else {
      fact('warning', TEXT.instruments, TEXT.never);
    }
    const several = items.map((one) => one.serial_number || one.model || one.driver).join(', ');
    if (items.length) fact('good', TEXT.several, several);
    else fact(item.serial_number ? 'good' : 'warning', TEXT.item, [item.maker, item.model, item.serial_number || TEXT.noItem].filter(Boolean).join(' '));
    fact('good', TEXT.plan, t`${plan.angles} angles, ${duration(time.total_s)}`);
    fact(operator.name ? 'good' : 'warning', TEXT.operator, operator.name ? operatorIn(operator.verified ? operator.name : `${operator.name} (stated, not verified)`) : TEXT.nobody);
    if (record) fact(record.age_months > record.validity_months || record.last_run?.agrees === false ? 'warning' : 'good', TEXT.record, t`${record.age_months.toFixed(1)} months old, good for ${record.validity_months.toFixed(1)}`);
    else fact('good', TEXT.record, TEXT.noRecord);
    if (register) fact('good', TEXT.register, register.name, register.training ? TEXT.training : '');
    else fact('warning', TEXT.register, TEXT.noRegister);
    fact(disk.free_bytes !== null && disk.free_bytes < disk.needed_bytes ? 'problem' : 'good', TEXT.disk, t`${gigabytes(disk.free_bytes)} free, ${gigabytes(disk.needed_bytes)} needed`);
    this.loaded(several || item.serial_number || item.model || '');
    byId('ready-facts').replaceChildren(...facts);
    const notices = [...answer.problems.map((words) => ['problem', words]), ...answer.warnings.map((words) => ['warning', words])];
    byId('ready-notices').firstElementChild.textContent = t`Notes before the start: ${notices.length}`;
    byId('ready-notices').lastElementChild.replaceChildren(...notices.map(([grade, words]) => element('li', {class: `grade-${grade}`}, said(words))));
  }
}
