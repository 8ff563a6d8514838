// A card for each of several items: its identity, how many angles are measured, and why it was left out.
import {element, number, signed, DASH} from '/text.js';
import {said} from '/said.js';
import {VERDICTS, VERDICT_SIGNS} from '/answer.js';
import {OUTPUTS} from '/plots.js';
import {t} from '/language.js';

function itemCard(item, of, ...more) {
  return element('li', {class: item.dropped ? 'left-out' : false, 'data-item': item.k},
    element('h4', {}, t`Item ${item.k}`, `: ${item.name}`), element('p', {}, item.model || DASH),
    element('p', {}, of === null ? t`${item.measured} angles` : t`${item.measured} of ${of} angles`),
    ...(item.dropped ? [element('p', {class: 'grade-warning'}, t('left out'), ': ', said(item.dropped))] : []), ...more);
}

// The card during a run, with the mean of the last angle.
export function liveItem(item, of) {
  const means = element('table', {}, element('caption', {}, t`Last mean (${item.unit})`),
    element('tbody', {}, ...OUTPUTS.map((name, j) => element('tr', {}, element('th', {scope: 'row'}, name), element('td', {class: 'number', 'data-heading': `${name} (${item.unit})`}, item.mean ? signed(item.mean[j], 6) : DASH)))));
  const temperature = item.temperature_degc === null ? [] : [element('p', {}, t`Temperature ${number(item.temperature_degc, 2, '°C')}`)];
  return itemCard(item, of, means, ...temperature, ...(item.flags ? [element('p', {class: 'grade-warning'}, item.flags)] : []));
}

// The choice before a run of several items begins or resumes: whether missing items are left out. id: that of the check box.
export function withoutMissing(id) {
  const box = element('input', {id, type: 'checkbox'});
  return {label: element('label', {class: 'check'}, box, element('span', {}, t('Leave out items that are not there, and measure the others'))),
    choice: () => (box.checked ? {without_missing_items: true} : {})};
}

// The cards in a result: the item that is shown, and links to the others.
export function resultItems(run, shown) {
  const card = (item) => {
    const made = itemCard({...item, name: item.serial_number}, run.planned || null,
      ...(item.verdict && item.dropped === null ? [element('p', {class: `mark-${item.verdict}`}, `${VERDICT_SIGNS[item.verdict]} ${VERDICTS[item.verdict]}`)] : []),
      element('p', {}, element('a', {href: `#runs/${encodeURIComponent(run.name)}/${item.k}`, 'aria-current': item.k === shown ? 'page' : false}, t`Result of item ${item.k}`)));
    if (item.k === shown) made.classList.add('shown');
    return made;
  };
  // The only heading above the cards is the hidden one of the view.
  return element('div', {id: 'result-items', role: 'navigation', 'aria-label': t('Items of this run'), class: 'no-print'}, element('h3', {class: 'visually-hidden'}, t('Items of this run')), element('ul', {class: 'items'}, ...run.items.map(card)));
}
