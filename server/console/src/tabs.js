// The parts of the panel, one at a time: arrows move between their tabs.

import { byId } from './dom.js';

/** `opened` is called with the name of the part that is shown. */
export function tabs(opened) {
  const all = [...document.querySelectorAll('[role=tab]')];
  const choose = (chosen, focus) => {
    for (const tab of all) {
      const is = tab === chosen;
      tab.setAttribute('aria-selected', String(is));
      tab.tabIndex = is ? 0 : -1;
      byId(tab.getAttribute('aria-controls')).hidden = !is;
    }
    if (focus) chosen.focus();
    opened(chosen.dataset.part);
  };
  for (const tab of all) {
    tab.addEventListener('click', () => choose(tab));
    tab.addEventListener('keydown', (event) => {
      const { key } = event;
      const shown = all.filter(({ hidden }) => !hidden);
      const at = shown.indexOf(tab);
      const to = { ArrowRight: at + 1, ArrowLeft: at - 1, Home: 0, End: shown.length - 1 }[key];
      if (to === undefined) return;
      event.preventDefault();
      choose(shown.at(to % shown.length), true);
    });
  }
  return (part) => choose(all.find((tab) => tab.dataset.part === part), true);
}
