// Numbers as people read them.

const whole = new Intl.NumberFormat('en', { maximumFractionDigits: 0 });
const short = new Intl.NumberFormat('en', { notation: 'compact', maximumFractionDigits: 1 });

export const count = (n) => (n < 100_000 ? whole.format(n) : short.format(n));

/** A number with about three significant digits. */
export const figure = (n) => (n >= 100 ? whole.format(n) : n >= 10 ? n.toFixed(1) : n.toFixed(2));

export const percent = (fraction) => `${Math.round(fraction * 100)} %`;

/** Bytes as [number, unit]. */
export function size(bytes) {
  const units = ['B', 'kB', 'MB', 'GB', 'TB'];
  const step = bytes > 0 ? Math.min(Math.floor(Math.log10(bytes) / 3), units.length - 1) : 0;
  return [step ? figure(bytes / 1000 ** step) : whole.format(bytes), units[step]];
}

/** Time since microseconds of the Unix epoch. */
export function ago(time_us) {
  const s = Math.max(0, Date.now() / 1000 - time_us / 1e6);
  if (s < 2) return 'now';
  if (s < 60) return `${Math.floor(s)} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min`;
  return s < 86_400 ? `${Math.floor(s / 3600)} h` : `${Math.floor(s / 86_400)} d`;
}

/** `TOO_LITTLE_MAP` as `too little map`. */
export const words = (constant) => constant.toLowerCase().replaceAll('_', ' ');

/** Degrees with a letter, `digits` after the point. */
export const degrees = (value, digits, [positive, negative]) =>
  `${Math.abs(value).toFixed(digits)}° ${value < 0 ? negative : positive}`;

export const position = (lng, lat) => `${degrees(lat, 6, 'NS')}  ${degrees(lng, 6, 'EW')}`;

/** The middle value, or the value at another fraction of the sorted list. */
export function quantile(values, fraction = 0.5) {
  const sorted = values.toSorted((a, b) => a - b);
  return sorted[Math.min(sorted.length - 1, Math.floor(sorted.length * fraction))];
}
