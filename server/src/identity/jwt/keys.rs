//! The issuer's public keys (JWKS), checked before they count.

use std::collections::HashMap;

use jsonwebtoken::jwk::{AlgorithmParameters, EllipticCurve, Jwk, KeyAlgorithm, PublicKeyUse};
use jsonwebtoken::{Algorithm, DecodingKey, DecodingKeyKind};
use serde::Deserialize;
use serde_json::Value;

/// Keys of a set, at most.
const MOST: usize = 64;
/// Characters of a key's id, at most.
const MAX_ID: usize = 256;
/// Bits of an RSA key, at least and at most.
const RSA_BITS: std::ops::RangeInclusive<usize> = 2048..=8192;

/// The keys that may sign tokens, by their ids; one without an id has the empty one.
#[derive(Clone, Default)]
pub struct Keys(HashMap<String, Key>);

/// A key, and the algorithms that it is for: all of one family.
#[derive(Clone)]
pub(super) struct Key {
    pub(super) algorithms: Vec<Algorithm>,
    pub(super) decoding: DecodingKey,
    /// To tell it from another one of the same id.
    print: Vec<u8>,
}

#[derive(Deserialize)]
struct Set {
    keys: Vec<Value>,
}

impl Keys {
    /// Of the text of a key set. Keys of kinds that sign no token here are passed over: symmetric ones, other curves, those for
    /// encryption.
    ///
    /// # Errors
    /// In words, when it is no key set, holds no key that can be used, or is ambiguous.
    pub(in crate::identity) fn read(bytes: &[u8]) -> Result<Self, String> {
        let set: Set =
            serde_json::from_slice(bytes).map_err(|error| format!("is no set of keys (JWKS): {error}"))?;
        if set.keys.len() > MOST {
            return Err(format!("holds {} keys; {MOST} at most", set.keys.len()));
        }
        let mut keys = HashMap::new();
        for jwk in set.keys.into_iter().filter_map(|key| serde_json::from_value::<Jwk>(key).ok()) {
            let id = jwk.common.key_id.clone().unwrap_or_default();
            let Some(key) = Key::of(&jwk) else { continue };
            if id.len() > MAX_ID {
                return Err(format!("holds a key whose id is longer than {MAX_ID} characters"));
            }
            if keys.insert(id, key).is_some() {
                return Err("holds two keys with the same id".to_owned());
            }
        }
        if keys.is_empty() {
            return Err(
                "holds no key for RS256, PS256, ES256 or EdDSA; publish one with `kid` and `use: sig`"
                    .to_owned(),
            );
        }
        Ok(Self(keys))
    }

    /// The key with an id; without one the only key there is.
    pub(super) fn get(&self, id: Option<&str>) -> Option<(&str, &Key)> {
        let found = match id {
            Some(id) => self.0.get_key_value(id),
            None => self.0.iter().next().filter(|_| self.0.len() == 1),
        };
        found.map(|(id, key)| (id.as_str(), key))
    }

    /// What tells a key from another of the same id.
    pub(super) fn print(&self, id: &str) -> Option<&[u8]> {
        self.0.get(id).map(|key| key.print.as_slice())
    }

    /// Is there none yet?
    pub(in crate::identity) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

impl Key {
    pub(super) fn print(&self) -> &[u8] {
        &self.print
    }

    fn of(jwk: &Jwk) -> Option<Self> {
        let named = jwk.common.key_algorithm;
        let allowed: &[(Algorithm, KeyAlgorithm)] = match &jwk.algorithm {
            AlgorithmParameters::RSA(_) => {
                &[(Algorithm::RS256, KeyAlgorithm::RS256), (Algorithm::PS256, KeyAlgorithm::PS256)]
            }
            AlgorithmParameters::EllipticCurve(of) if of.curve == EllipticCurve::P256 => {
                &[(Algorithm::ES256, KeyAlgorithm::ES256)]
            }
            AlgorithmParameters::OctetKeyPair(of) if of.curve == EllipticCurve::Ed25519 => {
                &[(Algorithm::EdDSA, KeyAlgorithm::EdDSA)]
            }
            _ => return None,
        };
        let for_signatures = matches!(jwk.common.public_key_use, None | Some(PublicKeyUse::Signature));
        let of_its_own = allowed.iter().filter(|(_, name)| named.is_none_or(|named| named == *name));
        let algorithms: Vec<_> = of_its_own.map(|(algorithm, _)| *algorithm).collect();
        let key = DecodingKey::from_jwk(jwk).ok()?;
        let print = print_of(key.kind())?;
        (for_signatures && !algorithms.is_empty()).then_some(Self { algorithms, decoding: key, print })
    }
}

/// The key's own bytes; nothing where they are too few or too many.
fn print_of(kind: &DecodingKeyKind) -> Option<Vec<u8>> {
    match kind {
        DecodingKeyKind::RsaModulusExponent { n, e } => {
            let modulus = n.strip_prefix(&[0]).unwrap_or(n);
            (RSA_BITS.contains(&(modulus.len() * 8)) && (1..=8).contains(&e.len()))
                .then(|| [n.as_slice(), e.as_slice()].concat())
        }
        // 32 bytes of Ed25519; 4 and both coordinates of P-256.
        DecodingKeyKind::SecretOrDer(bytes) => [32, 65].contains(&bytes.len()).then(|| bytes.clone()),
    }
}
