// The strip of single readings. It shows one of several items: the chosen one, else the first that takes part.
import {byId, element, number, signed, DASH} from '/text.js';
import {Chart, OUTPUTS} from '/plots.js';
import {t} from '/language.js';

const GROUPS = 400;  // Groups of all items, as many as the console keeps.

export class Strip {
  // changed: called when another item is chosen.
  constructor(changed) {
    this.groups = [];
    this.items = [];  // As in the messages; empty: a single item, or the items are unknown.
    this.chosen = null;
    this.chart = new Chart(byId('strip'), {name: t('Moving strip of the three outputs; the latest values are in the table below'), x: {words: t('time since the readings began (s)')}, y: t('output'),
      series: OUTPUTS.map((output) => ({output, label: output, line: true}))});
    byId('strip-item').addEventListener('change', () => { this.chosen = Number(byId('strip-item').value); changed(); });
  }

  begin(groups, items) {
    this.groups = groups;
    this.items = items;
  }

  receive(group) {
    // The readings of this item have started again: earlier groups have another zero of time.
    const last = this.groups.findLast(({item}) => item === group.item);
    if (last && last.stream !== group.stream) this.groups = this.groups.filter(({item}) => item !== group.item);
    this.groups.push(group);
    if (this.groups.length > GROUPS) this.groups.shift();
  }

  // The items that can be shown, by number.
  numbers() {
    return [...new Set([...this.items.map(({k}) => k), ...this.groups.map(({item}) => item)])].sort((a, b) => a - b);
  }

  shown(numbers) {
    return numbers.includes(this.chosen) ? this.chosen : this.items.find(({dropped}) => !dropped)?.k ?? numbers[0] ?? 1;
  }

  offer(numbers, shown) {
    byId('strip-choice').hidden = numbers.length < 2;
    byId('strip-of').textContent = numbers.length < 2 ? '' : `: ${t`Item ${shown}`}`;
    const select = byId('strip-item'), names = numbers.map((k) => [t`Item ${k}`, this.items.find((item) => item.k === k)?.name].filter(Boolean).join(': '));
    if ([...select.options].map(({text}) => text).join() !== names.join())
      select.replaceChildren(...numbers.map((k, i) => element('option', {value: k}, names[i])));
    if (Number(select.value) !== shown) select.value = shown;
  }

  draw() {
    const numbers = this.numbers(), shown = this.shown(numbers), groups = this.groups.filter(({item}) => item === shown);
    this.offer(numbers, shown);
    const last = groups.at(-1), unit = last ? last.unit : '';
    this.chart.unit = unit;
    this.chart.show(groups.map((group) => group.time_s), OUTPUTS.map((_, j) => groups.map((group) => group.mean[j])), {y: unit ? t`output (${unit})` : t('output')});
    byId('strip-table').replaceChildren(...OUTPUTS.map((name, j) => element('tr', {},
      element('th', {scope: 'row'}, name), element('td', {}, last ? signed(last.mean[j], 6, unit) : DASH),
      element('td', {}, last ? t`${signed(last.lowest[j], 6)} to ${signed(last.highest[j], 6, unit)}` : DASH))));
    byId('temperature').textContent = (last ? number(last.temperature_degc, 2, '°C') : DASH) + (numbers.length < 2 ? '' : ` (${t`Item ${shown}`})`);
  }
}
