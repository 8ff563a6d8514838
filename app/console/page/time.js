// All times on the page are of one kind, UTC or local, chosen by one switch. Each time is an element <time> with its moment and
// its form, and is written again when the switch is used.
import {element, DASH} from '/text.js';
import {t} from '/language.js';

const KEY = 'abcal-times';
let kind = localStorage.getItem(KEY) === 'local' ? 'local' : 'utc';

const two = (n) => String(n).padStart(2, '0');
const parts = (date) => (kind === 'utc'
  ? [date.getUTCFullYear(), date.getUTCMonth() + 1, date.getUTCDate(), date.getUTCHours(), date.getUTCMinutes(), date.getUTCSeconds()]
  : [date.getFullYear(), date.getMonth() + 1, date.getDate(), date.getHours(), date.getMinutes(), date.getSeconds()]);

export const zone = () => (kind === 'utc' ? 'UTC' : t('local'));

// form: 'clock' "14:03:22", 'day' "2026-03-01 14:03 UTC", 'date' "2026-03-01". moment: a Date or a text as the console sends it.
export function timeText(moment, form) {
  const date = new Date(moment);
  if (!moment || Number.isNaN(date.getTime())) return DASH;
  const [year, month, day, hour, minute, second] = parts(date);
  if (form === 'date') return `${year}-${two(month)}-${two(day)}`;
  if (form === 'clock') return `${two(hour)}:${two(minute)}:${two(second)} ${zone()}`;
  return `${year}-${two(month)}-${two(day)} ${two(hour)}:${two(minute)} ${zone()}`;
}

export function timeElement(moment, form) {
  if (!moment || Number.isNaN(new Date(moment).getTime())) return element('span', {}, DASH);
  return element('time', {datetime: new Date(moment).toISOString(), 'data-form': form}, timeText(moment, form));
}

// The button of the switch; `changed` is called when all times on the page are written again.
export function offerTimes(button, changed) {
  const show = () => { button.textContent = t`Times: ${zone()}`; button.setAttribute('aria-label', kind === 'utc' ? t`Times: ${zone()}; show local times` : t`Times: ${zone()}; show UTC times`); };
  button.addEventListener('click', () => {
    kind = kind === 'utc' ? 'local' : 'utc';
    localStorage.setItem(KEY, kind);
    show();
    for (const time of document.querySelectorAll('time[data-form]')) time.textContent = timeText(time.dateTime, time.dataset.form);
    changed();
  });
  show();
}
