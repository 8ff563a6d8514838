// The answer of a result: what was found, each with its expanded uncertainty, and what dominates it.
import {decimals, element, scrollable, signed, table, DASH} from '/text.js';
import {said} from '/said.js';
import {t} from '/language.js';
import {OUTPUTS} from '/plots.js';

export const VERDICTS = {usable: t('Usable'), doubtful: t('Doubtful'), not_usable: t('Not usable')};
export const VERDICT_SIGNS = {usable: '✓', doubtful: '?', not_usable: '✗'};  // They differ without colour.
export const COVERED = t('U: expanded uncertainty, for a coverage probability of 95.45 %.');

// "+1.002100 ± 0.000012": value and expanded uncertainty, to two digits of the latter.
function withExpanded(q) {
  if (q.value === null) return t('not determined');
  const expanded = q.coverage_factor === null || q.standard_uncertainty === null ? null : q.coverage_factor * q.standard_uncertainty;
  const digits = decimals(expanded ?? NaN);
  return `${signed(q.value, digits)} ± ${expanded === null ? t('not known') : expanded.toFixed(digits)}`;
}

// The values of a group of the result's `quantities`, row by row.
export const valuesOf = (result, group) => [group.path.split('/').slice(1).reduce((part, key) => part[key], result)].flat(2);

// Outputs beyond those of the protocol, which have tables of their own.
const furtherOutputs = (result) => result.quantities.filter(({kind, of_protocol: ofProtocol}) => kind === 'output' && !ofProtocol)
  .map((group) => scrollable('stack scroll-x', group.heading, table(`${group.heading} ± U`, [t('Quantity'), t('Value'), t('Unit')],
    valuesOf(result, group).map((q, i) => [group.symbols[i], withExpanded(q), q.unit]))));

const unitOf = (quantities) => quantities.find(({unit}) => unit)?.unit || '1';

// The nine values of a result that do not depend on the mounting, each with its U.
export function nineValues({intrinsic_sensitivity: s, intrinsic_angle: phi, offset: O}) {
  return scrollable('stack scroll-x', t('Intrinsic properties'), table(t`What does not depend on the mounting, ± U`, [t('Output'), t`Sensitivity (${unitOf(s)})`, t`Offset (${unitOf(O)})`, t('Angle between outputs'), t`Angle (${unitOf(phi)})`],
    OUTPUTS.map((name, j) => [name, withExpanded(s[j]), withExpanded(O[j]), ['u, v', 'v, w', 'w, u'][j], withExpanded(phi[j])])));
}

export function answer(result, dominates) {
  const {sensitivity_matrix: matrix} = result, parts = [];
  const isUsable = result.verdict !== 'not_usable';
  if (!isUsable) parts.push(element('p', {}, t('Nothing may be read from the numbers of this run.')));
  if (matrix && isUsable) {
    const made = table(t`Sensitivity matrix ± U, in ${unitOf(matrix.flat())}`, [t('Output'), t('along x'), t('along y'), t('along z')], matrix.map((row, j) => [OUTPUTS[j], ...row.map(withExpanded)]));
    parts.push(scrollable('stack scroll-x', t('Sensitivity matrix'), made));
  }
  if (isUsable) parts.push(nineValues(result), ...furtherOutputs(result), element('p', {}, COVERED));
  if (dominates.length) {
    const share = ({output, share: part}) => `${output} ${part === null ? DASH : Math.round(100 * part)} %`;
    parts.push(element('p', {}, t('What dominates U (largest part of the variance):')),
      element('ul', {id: 'dominates'}, ...dominates.map(({input, outputs}) => element('li', {}, said(input), `: ${outputs.map(share).join(', ')}`))));
  }
  const {notes} = result.diagnostics;
  if (notes.length) parts.push(element('p', {}, t('To be read with it:')), element('ul', {}, ...notes.map((note) => element('li', {}, said(note)))));
  return element('div', {id: 'answer'}, ...parts);
}
