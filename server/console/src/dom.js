// Small helpers for the page. Text always goes in as text, never as markup.

export const byId = (id) => document.getElementById(id);

/** An element with properties and children. */
export function el(tag, properties = {}, ...children) {
  const { data, ...rest } = properties;
  const element = Object.assign(document.createElement(tag), rest);
  Object.assign(element.dataset, data);
  element.append(...children.filter((child) => child != null));
  return element;
}

/** Stands where there is no number. */
export const NONE = '–';

/** Fills a <dl> with [term, value, unit] rows. */
export function numbers(list, rows) {
  list.replaceChildren(
    ...rows.map(([term, value, unit]) =>
      el('div', {}, el('dt', { textContent: term }), el('dd', {}, value, unit && value !== NONE ? el('small', { textContent: ` ${unit}` }) : null)),
    ),
  );
}

/** Replaces a list's rows and keeps the keyboard where it was. */
export function fill(list, rows) {
  const focused = [...list.querySelectorAll('button')].indexOf(document.activeElement);
  list.replaceChildren(...rows);
  if (focused >= 0) list.querySelectorAll('button')[focused]?.focus();
}

export const calm = matchMedia('(prefers-reduced-motion: reduce)');

/** Calls `work` once per `wait_ms` at most, after the first call of a burst. */
export function gathered(work, wait_ms) {
  let timer;
  return () => {
    timer ??= setTimeout(() => {
      timer = undefined;
      work();
    }, wait_ms);
  };
}
