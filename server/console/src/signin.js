// Signing in with a token, when the service asks who is there.

import { byId } from './dom.js';
import { changing, inSession, onSignIn } from './service.js';

let asking;

/** Asks for a token until the service takes one, or nobody wants to sign in. Requests at the same time ask once. */
function signIn() {
  asking ??= ask().finally(() => (asking = undefined));
  return asking;
}

async function ask() {
  const [dialog, token, note] = [byId('signin'), byId('signin-token'), byId('signin-note')];
  note.textContent = 'This service asks who is there. A token comes from whoever runs it.';
  const ways = await fetch('session/ways').then((answer) => answer.json()).catch(() => ({}));
  byId('signin-issuer').hidden = !ways.oidc;
  for (;;) {
    token.value = '';
    dialog.returnValue = '';
    if (!dialog.open) dialog.showModal();
    await new Promise((resolve) => dialog.addEventListener('close', resolve, { once: true }));
    if (dialog.returnValue !== 'yes') return;
    const answer = await fetch('session', {
      method: 'POST', headers: { 'content-type': 'application/json' }, body: JSON.stringify({ token: token.value }),
    });
    if (answer.ok) return showWho();
    const body = await answer.json().catch(() => undefined);
    note.textContent = body?.error?.message ?? `The service answered ${answer.status}.`;
  }
}

/** Shows who is signed in, where somebody is. */
async function showWho() {
  const answer = await fetch('session').catch(() => undefined);
  const { name, csrf } = answer?.ok ? await answer.json() : {};
  inSession(csrf);
  byId('signout').hidden = !name;
  byId('signout').textContent = `Sign out ${name ?? ''}`;
}

export function addSignIn() {
  onSignIn(signIn);
  byId('signout').addEventListener('click', async () => {
    await fetch('session', { method: 'DELETE', headers: changing() });
    location.reload();
  });
  showWho();
}
