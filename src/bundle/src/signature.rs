//! Keys and signatures in the formats of OpenSSH: a key of `ssh-keygen -t ed25519` signs here, and a signature from here is checked by
//! `ssh-keygen -Y verify`.

use ed25519_dalek::VerifyingKey;
use ssh_key::{
    HashAlg, LineEnding, PrivateKey, PublicKey, SshSig,
    private::{Ed25519Keypair, KeypairData},
};

use crate::BundleError;

/// What signatures of bundles are for; one for something else does not hold.
const NAMESPACE: &str = "reel-bundle";

/// A private Ed25519 key.
pub struct Key(PrivateKey);

impl std::fmt::Debug for Key {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Key({})", self.signer())
    }
}

impl Key {
    /// The Ed25519 key of 32 random bytes. The comment is for people.
    pub fn of_seed(seed: &[u8; 32], comment: &str) -> Self {
        let pair = Ed25519Keypair::from_seed(seed);
        let key = PrivateKey::new(KeypairData::Ed25519(pair), comment)
            .expect("an Ed25519 pair has no other form");
        Self(key)
    }

    /// A key as OpenSSH writes it into a file.
    ///
    /// # Errors
    /// When it is none, is encrypted, or is not of Ed25519.
    pub fn from_openssh(text: &str) -> Result<Self, BundleError> {
        let problem = |problem: &str| BundleError::Key {
            problem: problem.to_owned(),
        };
        let key = PrivateKey::from_openssh(text).map_err(|error| {
            problem(&format!(
                "it is no private key of OpenSSH ({error}); `reel key new` makes one"
            ))
        })?;
        if key.is_encrypted() {
            return Err(problem(
                "it has a passphrase; `reel key new` makes a key of its own for results",
            ));
        }
        match key.key_data() {
            KeypairData::Ed25519(_) => Ok(Self(key)),
            _ => Err(problem(
                "it is not of Ed25519; `reel key new` makes one that is",
            )),
        }
    }

    /// As OpenSSH writes it.
    pub fn to_openssh(&self) -> String {
        let text = self.0.to_openssh(LineEnding::LF);
        text.expect("an Ed25519 pair can be written").to_string()
    }

    /// The public half of the key.
    pub fn signer(&self) -> Signer {
        Signer(self.0.public_key().clone())
    }

    /// A signature of a statement.
    pub(crate) fn sign(&self, statement: &[u8]) -> Vec<u8> {
        let signature = self
            .0
            .sign(NAMESPACE, HashAlg::Sha512, statement)
            .expect("an Ed25519 pair signs everything");
        let text = signature.to_pem(LineEnding::LF);
        text.expect("a signature can be written").into_bytes()
    }
}

/// A public key, of whoever signed.
#[derive(Clone, PartialEq, Eq, Debug)]
pub struct Signer(PublicKey);

impl Signer {
    /// A key as it stands in a `.pub` file: `ssh-ed25519 AAAA... comment`.
    ///
    /// # Errors
    /// When it is none.
    pub fn from_openssh(text: &str) -> Result<Self, BundleError> {
        let key = PublicKey::from_openssh(text.trim()).map_err(|error| BundleError::Key {
            problem: format!("it is no public key like 'ssh-ed25519 AAAA...' ({error})"),
        })?;
        Self::of_key(key).map_err(|problem| BundleError::Key { problem })
    }

    /// A key that only its owner can sign with: of some points of the curve signatures can be made by everybody.
    fn of_key(key: PublicKey) -> Result<Self, String> {
        let point = key.key_data().ed25519().ok_or("it is not of Ed25519")?;
        match VerifyingKey::from_bytes(&point.0) {
            Ok(verifying) if !verifying.is_weak() => Ok(Self(key)),
            _ => Err("it is a weak key, with which everybody can sign".to_owned()),
        }
    }

    /// Who signed a statement.
    ///
    /// # Errors
    /// Why the signature does not hold.
    pub(crate) fn of_signature(signature: &[u8], statement: &[u8]) -> Result<Self, String> {
        let signed = SshSig::from_pem(signature)
            .map_err(|error| format!("the signature cannot be read: {error}"))?;
        let again = signed.to_pem(LineEnding::LF);
        if again.map(String::into_bytes).ok().as_deref() != Some(signature) {
            return Err("the signature is not written as OpenSSH does".to_owned());
        }
        let key = PublicKey::from(signed.public_key().clone());
        key.verify(NAMESPACE, statement, &signed)
            .map_err(|_| "the signature is not one of this statement".to_owned())?;
        Self::of_key(key).map_err(|problem| format!("the key of the signature: {problem}"))
    }

    /// Whether it is the same key, whatever its comment.
    pub fn is(&self, other: &Self) -> bool {
        self.0.key_data() == other.0.key_data()
    }

    /// As it stands in a `.pub` file.
    pub fn to_openssh(&self) -> String {
        self.0.to_openssh().expect("a public key can be written")
    }
}

impl std::fmt::Display for Signer {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}", self.0.fingerprint(HashAlg::Sha256))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_comes_back_from_its_text_and_signs() {
        let key = Key::of_seed(&[7; 32], "lab");
        let same = Key::from_openssh(&key.to_openssh()).unwrap();
        let signature = same.sign(b"statement");
        let signer = Signer::of_signature(&signature, b"statement").unwrap();
        assert!(signer.is(&key.signer()));
        assert!(
            Signer::from_openssh(&key.signer().to_openssh())
                .unwrap()
                .is(&signer)
        );
        assert!(!signer.is(&Key::of_seed(&[8; 32], "lab").signer()));
        assert!(signer.to_string().starts_with("SHA256:"));
    }

    #[test]
    fn a_signature_is_of_one_statement_and_has_one_form() {
        let signature = Key::of_seed(&[7; 32], "").sign(b"statement");
        assert!(Signer::of_signature(&signature, b"another").is_err());
        let mut spaced = signature.clone();
        spaced.push(b'\n');
        assert!(Signer::of_signature(&spaced, b"statement").is_err());
        for at in 0..signature.len() {
            let mut changed = signature.clone();
            changed[at] ^= 1;
            assert!(
                Signer::of_signature(&changed, b"statement").is_err(),
                "byte {at}"
            );
        }
    }

    #[test]
    fn what_is_no_key_is_told() {
        let text = Key::from_openssh("hello").unwrap_err().to_string();
        assert!(text.contains("reel key new"), "{text}");
        assert!(Signer::from_openssh("ssh-ed25519 hello").is_err());
    }
}
