// Numbers as people read them. A number that was not determined is a dash, and each has its unit.
export const DASH = '–';

export function number(value, digits, unit = '') {
  if (value === null || value === undefined || !Number.isFinite(value)) return DASH;
  return value.toFixed(digits) + (unit ? ` ${unit}` : '');
}

// With a sign, so that the signs in a column are aligned.
export function signed(value, digits, unit = '') {
  if (value === null || value === undefined || !Number.isFinite(value)) return DASH;
  const shown = Math.abs(value).toFixed(digits);
  return (value < 0 && Number(shown) !== 0 ? '−' : '+') + shown + (unit ? ` ${unit}` : '');
}

// The number of decimals that gives two significant digits of a value, usually an uncertainty.
export function decimals(value) {
  return value !== 0 && Number.isFinite(value) ? Math.min(12, Math.max(0, 1 - Math.floor(Math.log10(Math.abs(value))))) : 6;
}

// A value with two significant digits, as for an uncertainty.
export function small(value, unit = '') {
  if (value === null || value === undefined || !Number.isFinite(value)) return DASH;
  return value.toFixed(decimals(value)).replace('-', '−') + (unit ? ` ${unit}` : '');
}

export const degrees = (value, digits) => number(value, digits, '').replace('-', '−') + (Number.isFinite(value) && value !== null ? '°' : '');

export function duration(seconds) {
  if (seconds === null || seconds === undefined || !Number.isFinite(seconds)) return DASH;
  const s = Math.round(seconds);
  if (s < 60) return `${s} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min ${String(s % 60).padStart(2, '0')} s`;
  return `${Math.floor(s / 3600)} h ${String(Math.floor((s % 3600) / 60)).padStart(2, '0')} min`;
}

// An element with text and attributes; never HTML, so that no name of a file becomes markup.
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === false || value === null || value === undefined) continue;
    made.setAttribute(name, value === true ? '' : value);
  }
  made.append(...children.map((child) => (child instanceof Node ? child : String(child))));
  return made;
}

// A table: head is a list of words, rows are lists of cells; a row's first cell is its heading. Columns of numbers are set
// to the right. Each cell knows its heading, for narrow screens (.stack in the style sheet).
export function table(caption, head, rows) {
  const numeric = head.map((_, i) => i > 0 && rows.every((row) => /^[-+−]?\d[\d.e+−]*$|^–$/.test(String(row[i]))) && rows.some((row) => String(row[i]) !== DASH));
  const kind = (i) => numeric[i] && 'number';
  return element('table', {},
    element('caption', {}, caption),
    element('thead', {}, element('tr', {}, ...head.map((word, i) => element('th', {scope: 'col', class: kind(i)}, word)))),
    element('tbody', {}, ...rows.map((row) => element('tr', {},
      ...row.map((cell, i) => (i === 0 ? element('th', {scope: 'row'}, cell) : element('td', {class: kind(i), 'data-heading': head[i]}, cell)))))));
}

// A region for contents larger than their place, which can be scrolled with the keyboard.
export const scrollable = (kind, name, content) => element('div', {class: kind, tabindex: 0, role: 'region', 'aria-label': name}, content);

export const byId = (id) => document.getElementById(id);
