// The commands of the page by keyboard: Ctrl+K lists all views and every button that can be pressed now. It presses that button, which
// asks as it always does. It is not modal and lies below the banner: Stop stays in reach.
import {byId, element} from '/text.js';
import {t} from '/language.js';

const COMMANDS = 'nav a, #do-stop, #steering button, #try-demo, #interrupted button, #outcome-links a, #outcome-links button, #against-time, #responses button, #bench-body .bar > button, #notify, #times, #language, #log-out';

const isPossible = (command) => !command.disabled && !command.hidden && !command.closest('[hidden]:not(main > section)');
const nameOf = (command) => {
  const words = (command.firstChild?.data ?? command.textContent).trim();
  return command.closest('nav') ? t`Show: ${words}` : command.closest('#responses') ? t`Residuals of ${words}` : words;
};

export class Palette {
  constructor() {
    this.dialog = byId('palette');
    this.input = byId('palette-words');
    this.list = byId('palette-list');
    byId('commands').addEventListener('click', () => this.open());
    addEventListener('keydown', (event) => {
      if (event.key.toLowerCase() !== 'k' || !(event.ctrlKey || event.metaKey) || event.altKey || event.shiftKey) return;
      event.preventDefault();
      if (this.dialog.open) this.close(); else if (!byId('confirm').open) this.open();
    });
    this.input.addEventListener('input', () => this.find());
    this.dialog.addEventListener('keydown', (event) => this.key(event));
    this.dialog.addEventListener('focusout', ({relatedTarget}) => { if (!this.dialog.contains(relatedTarget)) this.dialog.close(); });
    this.list.addEventListener('pointerdown', (event) => event.preventDefault());  // The focus stays in the input.
    this.list.addEventListener('click', ({target}) => { const at = [...this.list.children].indexOf(target.closest('li')); if (at >= 0) this.press(at); });
  }

  open() {
    this.before = document.activeElement;
    this.dialog.show();
    this.input.value = '';
    this.input.focus();
    this.find();
  }

  close() {
    this.dialog.close();
    this.before?.focus({preventScroll: true});
  }

  // Lists the commands whose names contain every word that was typed.
  find() {
    const words = this.input.value.toLowerCase().split(/\s+/);
    this.found = [...document.querySelectorAll(COMMANDS)].filter(isPossible).filter((command) => words.every((word) => nameOf(command).toLowerCase().includes(word)));
    this.list.replaceChildren(...this.found.map((command, i) => element('li', {role: 'option', id: `command-${i}`}, nameOf(command))));
    if (!this.found.length) this.list.replaceChildren(element('li', {role: 'option', 'aria-disabled': 'true'}, t('No command has these words.')));
    this.choose(0);
  }

  choose(at) {
    const all = [...this.list.children];
    this.at = (at + all.length) % all.length;
    all.forEach((option, i) => option.setAttribute('aria-selected', i === this.at));
    this.input.setAttribute('aria-activedescendant', all[this.at].id);
    all[this.at].scrollIntoView({block: 'nearest'});
  }

  key(event) {
    const does = {ArrowDown: () => this.choose(this.at + 1), ArrowUp: () => this.choose(this.at - 1), Enter: () => this.press(this.at), Escape: () => this.close()}[event.key];
    if (!does || event.isComposing) return;
    event.preventDefault();
    does();
  }

  press(at) {
    const command = this.found[at];
    if (!command) return;
    this.close();
    if (isPossible(command)) command.click();
  }
}
