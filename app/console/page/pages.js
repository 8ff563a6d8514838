// A long table, shown a page at a time since a browser is slow with thousands of cells; printed as a whole.
import {element, table} from '/text.js';
import {t} from '/language.js';

const ROWS = 50;

export class PagedTable {
  // rows(from, to) returns the cells of these rows, and is called when they are shown. follow: as the table grows, its last page
  // is shown until another is chosen.
  constructor(holder, {caption, head, rows, follow = false}) {
    Object.assign(this, {holder, caption, head, rows, follow, grows: follow, count: 0, page: 0, whole: false});
    holder.classList.add('paged');
    holder.pagedTable = this;
  }

  get pages() { return Math.max(1, Math.ceil(this.count / ROWS)); }

  show(count) {
    this.count = count;
    if (this.follow) this.page = this.pages - 1;
    this.page = Math.min(this.page, this.pages - 1);
    const from = this.whole ? 0 : this.page * ROWS, to = this.whole ? count : Math.min(count, from + ROWS);
    const go = (words, page, name) => {
      const button = element('button', {type: 'button', disabled: page < 0 || page >= this.pages, 'data-go': name}, words);
      button.addEventListener('click', () => this.turn(page, name));
      return button;
    };
    const turning = count > ROWS ? [element('div', {class: 'bar', role: 'group', 'aria-label': t('Pages of the table')},
      go(t('Earlier rows'), this.page - 1, 'back'), go(t('Later rows'), this.page + 1, 'on'), t`Rows ${from + 1} to ${to} of ${count}`)] : [];
    this.holder.replaceChildren(...turning, table(this.caption(), this.head(), this.rows(from, to)));
  }

  turn(page, name) {
    this.follow = this.grows && page === this.pages - 1;
    this.page = page;
    this.show(this.count);
    const again = this.holder.querySelector(`[data-go=${name}]:enabled`) ?? this.holder.querySelector('[data-go]:enabled');
    again?.focus();
  }
}

// Shows every paged table as a whole, or a page at a time.
export function showWhole(whole) {
  for (const {pagedTable} of document.querySelectorAll('.paged')) {
    pagedTable.whole = whole;
    if (pagedTable.count > ROWS) pagedTable.show(pagedTable.count);
  }
}
