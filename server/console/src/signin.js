// Signing in with a token, when the service asks who is there.

import { byId } from './dom.js';
import { changing, inSession, onSignIn } from './service.js';

let asking;

/** Asks for a token until the service takes one, and the page begins anew, or nobody wants to sign in. Requests at the same time ask once. */
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
    // All that is shown depends on who looks.
    if (answer.ok) {
      location.reload();
      return new Promise(() => {});
    }
    const body = await answer.json().catch(() => undefined);
    note.textContent = body?.error?.message ?? `The service answered ${answer.status}.`;
  }
}

/** Shows who is signed in, where somebody is, and what it may do. */
async function showWho() {
  const answer = await fetch('session').catch(() => undefined);
  const { name, csrf, roles = [], known_by } = answer?.ok ? await answer.json() : {};
  inSession(csrf);
  const stranger = known_by === 'anonymous';
  byId('signout').hidden = !name && !stranger;
  byId('signout').textContent = stranger ? 'Sign in' : `Sign out ${name ?? ''}`;
  const operates = roles.some((role) => ['operator', 'admin'].includes(role));
  // What viewers may not do is not offered; the service refuses it, too.
  document.body.classList.toggle('looks', !operates);
  byId('t-contributors').hidden = !operates;
  byId('compare').closest('label').hidden = !operates;
}

/** Whether who is signed in decides, as far as is known. */
export const operates = () => !document.body.classList.contains('looks');

export function addSignIn() {
  document.body.classList.add('looks');
  onSignIn(signIn);
  byId('signout').addEventListener('click', async ({ currentTarget }) => {
    if (currentTarget.textContent === 'Sign in') return signIn();
    await fetch('session', { method: 'DELETE', headers: changing() });
    return location.reload();
  });
  return showWho();
}
