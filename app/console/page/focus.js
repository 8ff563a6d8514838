// Focus is never lost: if the focused element is disabled, hidden or removed, the nearest usable one gets the focus. It is never
// hidden under the banner.
const CONTROLS = 'button:enabled, a[href]:not(.skip), input:enabled, select:enabled, summary, [tabindex="0"]';
let around = [];  // The element that had the focus last, followed by its ancestors.

const usable = (element) => element.isConnected && element.checkVisibility({visibilityProperty: true}) && !element.matches(':disabled');

function keep() {
  const now = document.activeElement, [last, ...outer] = around;
  if (!last || (now === last && !last.disabled) || usable(last) || (now !== document.body && now !== null && now !== last)) return;
  for (const place of outer) {
    const heir = place.isConnected && [...place.querySelectorAll(CONTROLS)].find(usable);
    if (heir) return heir.focus({preventScroll: true});
  }
}

export function keepFocus(banner) {
  addEventListener('focusin', ({target}) => {
    // A browser takes a half visible link of the row for visible enough.
    if (target.closest('header')) target.scrollIntoView({block: 'nearest', inline: 'nearest'});
    around = [];
    for (let at = target; at && at !== document.documentElement; at = at.parentElement) around.push(at);
  });
  // After a click outside all controls nothing is to have the focus.
  addEventListener('pointerdown', () => { around = []; }, {capture: true});
  new MutationObserver(keep).observe(document.body, {subtree: true, childList: true, attributes: true, attributeFilter: ['disabled', 'hidden', 'class']});
  new ResizeObserver(() => { document.documentElement.style.scrollPaddingTop = `${banner.offsetHeight + 8}px`; }).observe(banner);
}
