// Signing in: a small dialog, when the service does not know who looks. The token goes to the service once; from then on the
// browser holds a cookie that no script can read.

import { el } from './dom.js';

let asking;

/** Resolves once the service knows who looks; all who ask meanwhile wait for the same dialog. */
export function signIn() {
  asking ??= shown().finally(() => {
    asking = undefined;
  });
  return asking;
}

function shown() {
  const token = el('input', { type: 'password', autocomplete: 'current-password', required: true, name: 'token' });
  const trouble = el('p', { role: 'alert' });
  const form = el(
    'form',
    { method: 'dialog' },
    el('h2', { textContent: 'Sign in' }),
    el('label', {}, 'Token ', token),
    trouble,
    el('button', { type: 'submit', textContent: 'Sign in' }),
  );
  const dialog = el('dialog', {}, form);
  dialog.addEventListener('cancel', (event) => event.preventDefault());
  document.body.append(dialog);
  dialog.showModal();
  return new Promise((resolve) => {
    form.addEventListener('submit', async (event) => {
      event.preventDefault();
      const refusal = await sent(token.value);
      trouble.textContent = refusal ?? '';
      if (refusal) return;
      dialog.remove();
      resolve();
    });
  });
}

/** Sends a token; gives the service's words if it is refused. */
async function sent(token) {
  try {
    const response = await fetch('/session', {
      method: 'POST',
      headers: { 'content-type': 'application/json' },
      body: JSON.stringify({ token }),
    });
    if (response.ok) return undefined;
    const body = await response.json().catch(() => undefined);
    return body?.error?.message ?? `the service answered ${response.status}`;
  } catch {
    return 'the service does not answer';
  }
}
