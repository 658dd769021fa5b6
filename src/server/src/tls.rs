//! TLS of the service: a certificate and its key from files, read again when they change.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, RwLock},
    time::SystemTime,
};

use serde::{Deserialize, Serialize};
use tokio_rustls::{
    TlsAcceptor,
    rustls::{
        ServerConfig, crypto,
        pki_types::{CertificateDer, PrivateKeyDer, pem::PemObject as _},
        server::{ClientHello, ResolvesServerCert},
        sign::CertifiedKey,
    },
};

/// Where the certificate and its key are.
#[derive(Clone, PartialEq, Eq, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsFiles {
    /// The certificate and those that vouch for it (PEM), its own first.
    pub cert: PathBuf,
    /// Its private key (PEM: PKCS #8, PKCS #1 or SEC 1).
    pub key: PathBuf,
}

/// Why there is no TLS.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "the messages name the fields")]
pub enum TlsError {
    /// A file cannot be read, or holds no PEM of what it should.
    #[error("cannot read the {what} {path}: {message}", path = path.display())]
    File {
        /// What the file should hold: `certificate` or `private key`.
        what: &'static str,
        path: PathBuf,
        message: String,
    },
    /// The key does not belong to the certificate, or is of a kind that TLS does not know.
    #[error(
        "cannot use the certificate {cert} with the key {key}: {message}",
        cert = .files.cert.display(), key = .files.key.display()
    )]
    Pair { files: TlsFiles, message: String },
}

/// A certificate that is in use, and whose files are looked after.
#[derive(Debug)]
pub(crate) struct Certificate {
    files: TlsFiles,
    current: RwLock<(Changed, Arc<CertifiedKey>)>,
}

/// When the two files were last changed.
type Changed = [Option<SystemTime>; 2];

impl Certificate {
    /// Reads certificate and key, and looks whether they belong together.
    ///
    /// # Errors
    /// When one cannot be read, or they do not belong together.
    pub fn read(files: &TlsFiles) -> Result<Arc<Self>, TlsError> {
        let changed = changed(files);
        Ok(Arc::new(Self {
            current: RwLock::new((changed, Arc::new(certified_key(files)?))),
            files: files.clone(),
        }))
    }

    /// Reads the files again if they have changed; whether they had. Where they cannot be used, the
    /// certificate stays as it was, and is tried again at the next change.
    ///
    /// # Errors
    /// When a file has changed and cannot be used, as [`Certificate::read`] says.
    pub fn refresh(&self) -> Result<bool, TlsError> {
        let now = changed(&self.files);
        {
            let mut current = self.current.write().expect("nobody panics with it");
            if current.0 == now {
                return Ok(false);
            }
            current.0 = now;
        }
        let new = Arc::new(certified_key(&self.files)?);
        self.current.write().expect("nobody panics with it").1 = new;
        Ok(true)
    }

    /// Accepts connections with it.
    pub fn acceptor(self: &Arc<Self>) -> TlsAcceptor {
        let provider = Arc::new(crypto::ring::default_provider());
        let config = ServerConfig::builder_with_provider(provider)
            .with_safe_default_protocol_versions()
            .expect("the provider knows them")
            .with_no_client_auth()
            .with_cert_resolver(self.clone());
        TlsAcceptor::from(Arc::new(config))
    }
}

impl ResolvesServerCert for Certificate {
    fn resolve(&self, _: ClientHello<'_>) -> Option<Arc<CertifiedKey>> {
        Some(self.current.read().ok()?.1.clone())
    }
}

fn changed(files: &TlsFiles) -> Changed {
    let at = |path: &Path| path.metadata().and_then(|it| it.modified()).ok();
    [at(&files.cert), at(&files.key)]
}

fn certified_key(files: &TlsFiles) -> Result<CertifiedKey, TlsError> {
    let failed = |what, path: &Path, message: String| TlsError::File {
        what,
        path: path.to_owned(),
        message,
    };
    let certificates: Vec<_> = CertificateDer::pem_file_iter(&files.cert)
        .and_then(Iterator::collect)
        .map_err(|error| failed("certificate", &files.cert, error.to_string()))?;
    if certificates.is_empty() {
        let none = "it holds no certificate (PEM)".to_owned();
        return Err(failed("certificate", &files.cert, none));
    }
    let key = PrivateKeyDer::from_pem_file(&files.key)
        .map_err(|error| failed("private key", &files.key, error.to_string()))?;
    CertifiedKey::from_der(certificates, key, &crypto::ring::default_provider()).map_err(|error| {
        TlsError::Pair {
            files: files.clone(),
            message: error.to_string(),
        }
    })
}
