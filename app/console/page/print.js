// On paper folded contents are shown, and the plots have the colours of print.css.
import {showWhole} from '/pages.js';
import {repaint} from '/plots.js';

export function readyForPaper() {
  let folded = [];
  matchMedia('print').addEventListener('change', repaint);
  addEventListener('beforeprint', () => {
    folded = [...document.querySelectorAll('details:not([open])')];
    for (const details of folded) details.open = true;
    showWhole(true);
    repaint();
  });
  addEventListener('afterprint', () => {
    showWhole(false);
    for (const details of folded) details.open = false;
    repaint();
  });
}
