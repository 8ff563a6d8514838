// The queue of items and plans: add, reorder, repeat, remove, pause; between two items the next one is mounted and checked.
// Nothing starts by itself except a further run of the item that stays mounted.
import {byId, element, table, DASH} from '/text.js';
import {said} from '/said.js';
import {t} from '/language.js';
import {StartForm} from '/start.js';

// The texts without values.
const TEXT = {
  title: t('Queue'), add: t('Add an item'), goOn: t('Let the queue go on'), pause: t('Pause the queue'), paused: t('The queue is paused: nothing of it is asked for or started.'),
  goes: t('The queue goes on. Nothing moves to the next item until a person confirms.'), empty: t('The queue is empty.'), nothingLeft: t('All that was in the queue is done.'),
  check: t('It is mounted: check it'), start: t('Start'), again: t('Check it again'), next: t('Next'),
  checkFirst: t('Its identity is asked, and it is read at rest where the stage stands. Nothing moves.'), passed: t('Nothing speaks against starting.'), failed: t('It cannot be started.'),
  up: t('Up'), down: t('Down'), repeat: t('Once more'), remove: t('Remove'), waits: t('waits'), now: t('is measured'), done: t('done'),
  caption: t('Items in the order in which they are measured'), addTitle: t('Add to the queue?'), addText: t('Nothing moves now.'), addYes: t('Add'), resumeHint: t('resume it in the list of runs, or let the queue go on: then it begins anew'),
  startYes: t('Start, and turn the stage'),
  heading: [t('Item'), t('Model'), t('Plan'), t('Runs'), t('State'), t('Change')], asBench: t('as the bench file'),
  open: t('Open the queue'), grades: [t('Check'), t('Grade'), t('Found'), t('Advice')], findings: t('What was found of the item'),
};

const planWords = ({steps, dwell_readings: readings, estimator}) => [steps && t`3 x ${steps} angles`, readings && t`${readings} readings`, estimator].filter(Boolean).join(', ') || TEXT.asBench;
const itemWords = ({maker, model, serial_number: serial, customer_number: number}) => [serial, [maker, model].filter(Boolean).join(' '), number && `(${number})`].filter(Boolean).join(', ');

export class QueueView {
  // ask(name, request, {moves}) and confirmed(title, text, yes, more) are those of the page; clear: the question before a motion.
  constructor({ask, confirmed, clear, pace}) {
    Object.assign(this, {ask, confirmed, clear, pace, queue: null, may: false, idle: true});
    const button = (id, words, act) => {
      const made = element('button', {type: 'button', id}, words);
      made.addEventListener('click', act);
      return made;
    };
    this.add = button('queue-add', TEXT.add, () => this.addItem());
    this.pauses = button('queue-pause', TEXT.goOn, () => this.ask(TEXT.title, {do: 'queue_pause', go_on: this.queue.paused}, {moves: false}));
    this.state = element('p', {id: 'queue-state', role: 'status'});
    this.next = element('section', {class: 'card block', id: 'queue-next', 'aria-label': TEXT.next, hidden: true});
    this.list = element('div', {class: 'scroll-x stack', id: 'queue-list'});
    byId('queue-body').replaceChildren(element('div', {class: 'bar'}, this.add, this.pauses), this.state, this.next, this.list);
  }

  receive(message) {
    if (message.type === 'snapshot' && message.queue) this.show(message.queue);
    if (message.type === 'queue') this.show(message);
  }

  // may: this page steers; idle: the bench is idle.
  offer(may, idle) {
    if (this.may === may && this.idle === idle) return;
    this.may = may;
    this.idle = idle;
    this.enable();
  }

  enable() {
    for (const button of byId('view-queue').querySelectorAll('button')) button.disabled = !this.may || (button.dataset.needs === 'idle' && !this.idle) || button.dataset.never === 'true';
  }

  show(queue) {
    this.queue = queue;
    const label = byId('queue-body').contains(document.activeElement) && document.activeElement.getAttribute('aria-label');
    const {entries, paused} = queue, next = entries.find(({number}) => number === queue.next);
    this.pauses.textContent = paused ? TEXT.goOn : TEXT.pause;
    this.state.replaceChildren(queue.problem ? said(queue.problem) : !entries.length ? TEXT.empty : paused ? TEXT.paused : !next ? TEXT.nothingLeft : TEXT.goes);
    this.state.className = queue.problem ? 'grade-problem' : '';
    this.showNext(paused ? null : next);
    this.showList(entries);
    this.enable();
    // The pressed button is made again, perhaps in another row: the new one gets the focus.
    if (label && document.activeElement === document.body) [...byId('queue-body').querySelectorAll('button:enabled')].find((button) => button.getAttribute('aria-label') === label)?.focus();
  }

  button(words, act, {needs = '', never = false, label = words, kind = ''} = {}) {
    const made = element('button', {type: 'button', 'data-needs': needs, 'data-never': never, 'aria-label': label, class: kind}, words);
    made.addEventListener('click', act);
    return made;
  }

  showNext(next) {
    const running = this.queue.entries.some(({now}) => now);
    this.next.hidden = !next || running;
    const hint = byId('queue-asks');
    hint.hidden = this.next.hidden;
    if (this.next.hidden) return;
    const item = itemWords(next.choice.item), {check} = this.queue;
    hint.replaceChildren(t`The queue asks for an item to be mounted: ${item}. `, element('a', {href: '#queue'}, TEXT.open));
    const checked = check && check.of === next.number ? check : null;
    this.next.replaceChildren(element('h3', {}, t`Mount ${item}`), element('p', {}, TEXT.checkFirst),
      ...(checked ? [element('p', {class: checked.passed ? 'grade-good' : 'grade-problem', role: 'status'}, checked.passed ? TEXT.passed : TEXT.failed),
        element('div', {class: 'stack'}, table(TEXT.findings, TEXT.grades, checked.findings.map((f) => [said(f.what), element('span', {class: `grade-${f.grade.replace(' ', '-')}`}, t(f.grade)), said(f.found), f.advice ? said(f.advice) : DASH])))] : []),
      element('div', {class: 'bar'},
        this.button(checked ? TEXT.again : TEXT.check, () => this.ask(TEXT.check, {do: 'queue_mounted', entry: next.number}, {moves: false}), {needs: 'idle', kind: 'queue-check'}),
        ...(checked?.passed ? [this.button(TEXT.start, () => this.start(next, item), {needs: 'idle', kind: 'queue-start go'})] : [])));
  }

  async start(entry, item) {
    if (await this.confirmed(t`Start ${item}?`, t`The stage moves through all three experiments. ${this.clear}`, TEXT.startYes) && await this.ask(TEXT.start, {do: 'queue_start', entry: entry.number, confirmed: true}))
      location.hash = '#live';
  }

  showList(entries) {
    if (!entries.length) return this.list.replaceChildren();
    const change = (entry, request) => this.ask(TEXT.title, {...request, entry: entry.number}, {moves: false});
    this.list.replaceChildren(table(TEXT.caption, TEXT.heading, entries.map((entry) => {
      const item = itemWords(entry.choice.item), done = entry.made.length >= entry.wanted, fixed = done || Boolean(entry.now);
      const button = (words, request, more = {}) => this.button(words, () => change(entry, request), {label: `${words}: ${item}`, ...more});
      const runs = element('span', {}, t`${entry.made.length} of ${entry.wanted}`, ...entry.made.flatMap((name) => [' ', element('a', {href: `#runs/${encodeURIComponent(name)}`}, name)]));
      const state = entry.now ? TEXT.now : done ? TEXT.done : entry.problem ? element('span', {}, said(entry.problem), entry.interrupted ? `: ${TEXT.resumeHint}` : '') : TEXT.waits;
      return [itemWords({...entry.choice.item, maker: '', model: ''}), [entry.choice.item.maker, entry.choice.item.model].filter(Boolean).join(' ') || DASH, planWords(entry.choice), runs, state,
        element('span', {class: 'bar'}, button(TEXT.up, {do: 'queue_move', by: -1}, {never: fixed}), button(TEXT.down, {do: 'queue_move', by: 1}, {never: fixed}),
          button(TEXT.repeat, {do: 'queue_repeat'}), button(TEXT.remove, {do: 'queue_remove'}, {never: Boolean(entry.now)}))];
    })));
  }

  async addItem() {
    const form = new StartForm(this.pace(), {runs: 1});
    if (!await this.confirmed(TEXT.addTitle, TEXT.addText, TEXT.addYes, form)) return;
    const {item, steps, dwell_readings, estimator} = form.choice();
    await this.ask(TEXT.add, {do: 'queue_add', item, steps, dwell_readings, estimator, runs: Number(form.fields.runs)}, {moves: false});
  }
}
