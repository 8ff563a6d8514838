// Texts of the program in the language of the page. With each text the console sends its sentence and its values (docs/console_programs.md,
// `messages`); a text without them, e.g. one that a person wrote, stays as it is, and is marked as English.
import {language} from '/language.js';

const table = language === 'en' ? {} : await (await fetch(`/certificate_${language}.json`)).json();
const place = /(\{\w+\})/;
const MOST = 5000;  // Messages that are kept.
const messages = new Map();  // By their English texts.

// Takes note of all messages of an answer of the console.
export function know(answer) {
  if (language === 'en' || answer === null || typeof answer !== 'object') return;
  if (typeof answer.id === 'string' && typeof answer.text === 'string') {
    messages.set(answer.text, answer);
    if (messages.size > MOST) messages.delete(messages.keys().next().value);
    return;
  }
  for (const part of Object.values(answer)) know(part);
}

// The parts of a value of a message: a text that is the same in every language, a number, a message, several.
function partsOfValue(value) {
  if (typeof value === 'string') return [value];
  if (value.number !== undefined) return [value.number];
  if (!value.messages) return partsOf(value);
  return value.messages.flatMap((each, i) => (i ? [value.separator] : []).concat(partsOf(each)));
}

// The parts of a message in the language of the page; {english}: one without a translation.
function partsOf({text, id, values = {}}) {
  const sentence = table[id] ?? (id !== undefined && !/[a-z]/i.test(id.split(place).filter((_, i) => i % 2 === 0).join('')) ? id : undefined);
  if (sentence === undefined) return [{english: text}];
  return sentence.split(place).flatMap((part, i) => (i % 2 ? partsOfValue(values[part.slice(1, -1)] ?? part) : part ? [part] : []));
}

const known = (words) => (messages.has(words) ? partsOf(messages.get(words)) : [{english: words}]);  // On an English page none is kept.

// The translation of a text; null: no part of it has one.
export function translated(words) {
  const parts = known(words);
  return parts.every((part) => part.english !== undefined) ? null : parts.map((part) => part.english ?? part).join('');
}

// A word of a vocabulary of the program: a kind of event, a flag, a check.
export const term = (word) => table[word] ?? word;

// An element with a text; what has no translation is marked as English in it.
export function said(words, {capital = false} = {}) {
  const holder = document.createElement('span'), parts = known(words);
  const written = (text, i) => (capital && i === 0 && text ? text[0].toUpperCase() + text.slice(1) : text);
  if (parts.length === 1 && parts[0].english !== undefined) {
    holder.lang = 'en';
    holder.append(written(parts[0].english, 0));
    return holder;
  }
  holder.append(...parts.map((part, i) => {
    if (part.english === undefined) return written(part, i);
    const inEnglish = document.createElement('span');
    inEnglish.lang = 'en';
    inEnglish.append(written(part.english, i));
    return inEnglish;
  }));
  return holder;
}
