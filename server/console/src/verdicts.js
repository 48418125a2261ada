// The verdicts of a fix, in families an operator distinguishes at a glance.

const FAMILIES = [
  { name: 'usable', color: '#b6ff5a', statuses: ['USABLE'] },
  { name: 'ambiguous', color: '#ffc14d', statuses: ['AMBIGUOUS', 'AMBIGUOUS_ALONG_TRACK', 'ABOVE_ALERT_LIMIT'] },
  { name: 'elsewhere', color: '#ff6b7a', statuses: ['PRIOR_OUTSIDE_SEARCH', 'MAP_STALE', 'LOST'] },
  { name: 'too little', color: '#b9a5ff', statuses: ['TOO_LITTLE_STRUCTURE', 'TOO_LITTLE_MAP'] },
];
const OTHER = { name: 'other', color: '#9fb0c4', statuses: [] };

export const families = [...FAMILIES, OTHER];

export const familyOf = (status) => FAMILIES.find(({ statuses }) => statuses.includes(status)) ?? OTHER;
