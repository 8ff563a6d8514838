// The results that only a run at a constant rate gives: the response at each rate, delays, places of the elements.
import {decimals, element, number, scrollable, signed, small, table, DASH} from '/text.js';
import {t} from '/language.js';
import {Chart, OUTPUTS, outputSeries, place} from '/plots.js';

const both = (q) => (q.value === null ? [DASH, DASH] : [signed(q.value, decimals(q.standard_uncertainty ?? NaN)), small(q.standard_uncertainty)]);

// charts: where the charts are kept until another view is shown.
export function motionCard(motion, charts) {
  const {responses, position, delay, delay_difference: differences, rate_offset: offsets, axes_distance: distance} = motion, holder = place();
  const rates = table(t('Amplitude relative to rest, and phase beyond that of the delay; standard uncertainties (k = 1)'),
    [t('Rate (degrees/s)'), t('Frequency (Hz)'), ...OUTPUTS.flatMap((name) => [t`${name}: amplitude (1)`, t('std. uncertainty (1)')]), t('Phase (degrees)'), t('std. uncertainty (degrees)')],
    responses.map((one) => [number(one.rate_deg_per_s, 2).replace('-', '−'), number(one.frequency_hz, 4), ...one.amplitude.flatMap(both), ...both(one.phase_beyond_delay)]));
  const others = [...OUTPUTS.flatMap((name, j) => ['x', 'y', 'z'].map((axis, k) => [t`Place of the element of ${name} along ${axis}`, position[j][k]])),
    ...['X', 'Z'].map((axis, k) => [t`Delay behind the encoder of ${axis}`, delay[k]]), ...OUTPUTS.map((name, j) => [t`Further delay of ${name}`, differences[j]]),
    ...OUTPUTS.map((name, j) => [t`Offset of ${name} at 60 degrees/s`, offsets[j]]), [t('Distance of the axes'), distance]];
  const rest = table(t('Delays, places of the elements, offsets with the rate; standard uncertainties (k = 1)'), [t('Quantity'), t('Value'), t('std. uncertainty'), t('Unit')],
    others.map(([name, q]) => [name, ...both(q), q.unit || '1']));
  queueMicrotask(() => {
    const chart = new Chart(holder, {name: t('Amplitude at each rate with bars of ±2 u; the table has the numbers'), x: {words: t('rate (degrees/s)')}, y: t('amplitude relative to rest (1)'), series: outputSeries({line: true})});
    const sorted = [...responses].sort((a, b) => a.rate_deg_per_s - b.rate_deg_per_s), column = (read) => OUTPUTS.map((_, j) => sorted.map((one) => read(one.amplitude[j])));
    chart.show(sorted.map((one) => one.rate_deg_per_s), column(({value}) => value), {bars: column(({standard_uncertainty: u}) => u ?? 0)});
    charts.push(chart);
  });
  return element('div', {id: 'motion'}, holder, scrollable('scroll-x', t('Response at each rate'), rates), element('details', {}, element('summary', {}, t('Delays, places of the elements, offsets with the rate')), scrollable('scroll-x', t('Delays, places of the elements, offsets with the rate'), rest)));
}
