//! Who belongs to a cluster: whoever shows a certificate of its authority, and is the same build of
//! Reel. Each process has one file with its key, its certificate and that of the authority; both
//! ends of every connection are checked. Without such files connections are in the clear, and the
//! build alone is checked.

use std::{
    fs::{self, OpenOptions},
    io::{self, Write as _},
    path::{Path, PathBuf},
    sync::Arc,
    time::{Duration, Instant},
};

use ballista_core::{
    extension::EndpointOverrideFn,
    serde::protobuf::{GetJobStatusParams, scheduler_grpc_client::SchedulerGrpcClient},
};
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose,
};
use reel_tables::buckets::with_causes;
use tokio_rustls::rustls::crypto;
use tonic::{
    Code, Request, Status,
    transport::{
        Certificate, ClientTlsConfig, Endpoint, Identity as TlsIdentity, Server, ServerTlsConfig,
    },
};

use crate::{Address, ClusterError};

/// The name in every certificate: machines of a lab have changing names, and belonging to the
/// authority is what counts.
const NAME: &str = "reel-cluster";
/// The files of an authority.
const AUTHORITY: [&str; 2] = ["authority.pem", "authority.key"];
/// How long the other end may take to say whether it takes us.
const PATIENCE: Duration = Duration::from_secs(5);

/// The key and certificate of a process, and the certificate of the authority whose members it
/// talks to.
#[derive(Clone, PartialEq, Eq)]
pub struct Identity {
    key: String,
    certificate: String,
    authority: String,
}

impl std::fmt::Debug for Identity {
    /// Shows that there is one, and never its key.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Identity").finish_non_exhaustive()
    }
}

impl Identity {
    /// Reads a file that [`issue`] made.
    ///
    /// # Errors
    /// When it cannot be read, or does not hold a private key and two certificates in PEM.
    pub fn read(path: &Path) -> Result<Self, ClusterError> {
        let wrong = |reason: String| ClusterError::Identity {
            path: path.to_owned(),
            reason,
        };
        // Two providers are linked in, and tonic takes the one of the process: it is this one,
        // unless somebody chose before.
        let _ = crypto::ring::default_provider().install_default();
        let text = fs::read_to_string(path).map_err(|error| wrong(error.to_string()))?;
        let (mut keys, mut certificates, mut block) = (Vec::new(), Vec::new(), String::new());
        for line in text.lines() {
            if line.starts_with("-----BEGIN ") {
                block.clear();
            }
            block.push_str(line);
            block.push('\n');
            match line.strip_prefix("-----END ") {
                Some("CERTIFICATE-----") => certificates.push(block.clone()),
                Some(kind) if kind.ends_with("PRIVATE KEY-----") => keys.push(block.clone()),
                _ => {}
            }
        }
        match (
            <[String; 1]>::try_from(keys),
            <[String; 2]>::try_from(certificates),
        ) {
            (Ok([key]), Ok([certificate, authority])) => Ok(Self {
                key,
                certificate,
                authority,
            }),
            _ => Err(wrong(
                "it does not hold a private key, its certificate and that of the authority"
                    .to_owned(),
            )),
        }
    }
}

/// What a process of a cluster shows to others, and asks of them.
#[derive(Clone, Debug)]
pub struct Credentials {
    /// Without one, connections are in the clear and open to everyone.
    pub identity: Option<Identity>,
    /// Names this program: processes of another one are refused.
    pub build: String,
}

impl Credentials {
    /// Makes of an endpoint one that shows what these credentials have.
    pub(crate) fn endpoints(&self) -> EndpointOverrideFn {
        let (agent, identity) = (self.agent(), self.identity.clone());
        Arc::new(move |endpoint: Endpoint| {
            let endpoint = match &identity {
                None => endpoint,
                Some(identity) => {
                    let tls = ClientTlsConfig::new()
                        .domain_name(NAME)
                        .ca_certificate(Certificate::from_pem(&identity.authority))
                        .identity(TlsIdentity::from_pem(&identity.certificate, &identity.key));
                    encrypted(endpoint)?.tls_config(tls)?
                }
            };
            Ok(endpoint.user_agent(agent.clone())?)
        })
    }

    /// A server that talks to members alone.
    pub(crate) fn server(&self) -> Result<Server, tonic::transport::Error> {
        let server = Server::builder().tcp_nodelay(true);
        let Some(identity) = &self.identity else {
            return Ok(server);
        };
        server.tls_config(
            ServerTlsConfig::new()
                .identity(TlsIdentity::from_pem(&identity.certificate, &identity.key))
                .client_ca_root(Certificate::from_pem(&identity.authority)),
        )
    }

    /// Refuses requests of other builds.
    pub(crate) fn guard(
        &self,
    ) -> impl Fn(Request<()>) -> Result<Request<()>, Status> + Clone + Send + Sync + use<> {
        let (agent, build) = (self.agent(), self.build.clone());
        move |request| {
            let shown = request.metadata().get("user-agent");
            let shown = shown
                .and_then(|value| value.to_str().ok())
                .unwrap_or_default();
            match shown.split(' ').next() {
                Some(first) if first == agent => Ok(request),
                _ => Err(Status::permission_denied(format!(
                    "it is of build {build}, who asks is of another one: both have to be the same"
                ))),
            }
        }
    }

    /// Whether a scheduler takes us; waits up to `patience` for one that answers.
    pub(crate) async fn check(
        &self,
        address: &Address,
        patience: Duration,
    ) -> Result<(), ClusterError> {
        let begun = Instant::now();
        loop {
            let asked = tokio::time::timeout(PATIENCE, self.ask(address)).await;
            let reason = match asked {
                Ok(Ok(())) => return Ok(()),
                Ok(Err(Refusal::Denied(reason))) => return Err(ClusterError::Refused { reason }),
                Ok(Err(Refusal::Silent(reason))) => reason,
                Err(_) => format!("it does not answer within {} s", PATIENCE.as_secs()),
            };
            if begun.elapsed() >= patience {
                let identity = match self.identity {
                    Some(_) => "; both ends need an identity of the same authority",
                    None => "; a cluster with identities wants one: --identity",
                };
                return Err(ClusterError::Silent {
                    address: address.to_string(),
                    reason: reason + identity,
                });
            }
            tokio::time::sleep(Duration::from_millis(500)).await;
        }
    }

    async fn ask(&self, address: &Address) -> Result<(), Refusal> {
        let silent = |error: &dyn std::error::Error| Refusal::Silent(with_causes(error));
        let endpoint =
            Endpoint::from_shared(format!("http://{address}")).map_err(|it| silent(&it))?;
        let endpoint = self.endpoints()(endpoint).map_err(|it| silent(it.as_ref()))?;
        let channel = endpoint.connect().await.map_err(|it| silent(&it))?;
        let nobodys = GetJobStatusParams {
            job_id: String::new(),
        };
        // The certificate of a client is looked at after its side of the handshake is over.
        match SchedulerGrpcClient::new(channel)
            .get_job_status(nobodys)
            .await
        {
            Ok(_) => Ok(()),
            Err(status) if status.code() == Code::PermissionDenied => {
                Err(Refusal::Denied(status.message().to_owned()))
            }
            // What the transport says of itself would tell nobody more.
            Err(status) if std::error::Error::source(&status).is_some() => {
                Err(Refusal::Silent("it closed the connection".to_owned()))
            }
            // It spoke, if only to say that there is no such job.
            Err(_) => Ok(()),
        }
    }

    fn agent(&self) -> String {
        let plain = |c: char| c.is_ascii_alphanumeric() || "-_.".contains(c);
        let build = self.build.chars().map(|c| if plain(c) { c } else { '_' });
        format!("reel/{}", build.collect::<String>())
    }
}

/// Why a scheduler cannot be asked.
enum Refusal {
    /// It refused the build, in these words.
    Denied(String),
    /// It gave no answer, for this reason.
    Silent(String),
}

/// The same endpoint, reached by TLS.
fn encrypted(endpoint: Endpoint) -> Result<Endpoint, tonic::transport::Error> {
    let uri = endpoint.uri().to_string();
    match uri.strip_prefix("http://") {
        None => Ok(endpoint),
        Some(rest) => Ok(Endpoint::from_shared(format!("https://{rest}"))?
            .tcp_nodelay(true)
            .connect_timeout(Duration::from_secs(20))
            .http2_keep_alive_interval(Duration::from_secs(300))
            .keep_alive_timeout(Duration::from_secs(20))
            .keep_alive_while_idle(true)),
    }
}

/// Makes files of identity for these names in a folder, by the authority whose key lies there;
/// makes the authority where there is none. The new files, in the order of the names.
///
/// # Errors
/// When the folder holds half an authority, a file cannot be written, or one is there already.
pub fn issue(folder: &Path, names: &[String], days: u32) -> Result<Vec<PathBuf>, ClusterError> {
    let wrong = |path: PathBuf| move |reason: String| ClusterError::Identity { path, reason };
    fs::create_dir_all(folder).map_err(|error| wrong(folder.to_owned())(error.to_string()))?;
    let [certificate, key] = AUTHORITY.map(|name| folder.join(name));
    if !certificate.exists() && !key.exists() {
        let made = KeyPair::generate().and_then(|made| {
            let signed = authority().self_signed(&made)?;
            Ok((made.serialize_pem(), signed.pem()))
        });
        let (secret, public) = made.map_err(|error| wrong(key.clone())(error.to_string()))?;
        write(&key, &secret).map_err(|error| wrong(key.clone())(error.to_string()))?;
        write(&certificate, &public)
            .map_err(|error| wrong(certificate.clone())(error.to_string()))?;
    }
    let read = |path: &PathBuf| {
        fs::read_to_string(path).map_err(|error| wrong(path.clone())(error.to_string()))
    };
    let (public, secret) = (read(&certificate)?, read(&key)?);
    let secret =
        KeyPair::from_pem(&secret).map_err(|error| wrong(key.clone())(error.to_string()))?;
    let issuer = Issuer::new(authority(), secret);
    names
        .iter()
        .map(|name| {
            let path = folder.join(format!("{name}.pem"));
            let made = KeyPair::generate().and_then(|made| {
                let signed = member(name, days)?.signed_by(&made, &issuer)?;
                Ok(format!("{}{}{public}", made.serialize_pem(), signed.pem()))
            });
            let text = made.map_err(|error| wrong(path.clone())(error.to_string()))?;
            write(&path, &text).map_err(|error| wrong(path.clone())(error.to_string()))?;
            Ok(path)
        })
        .collect()
}

/// The authority of a cluster. What it is made of never changes: what it signed stays valid.
fn authority() -> CertificateParams {
    let mut params = CertificateParams::default();
    params
        .distinguished_name
        .push(DnType::CommonName, "Authority of a Reel cluster");
    params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
    params.key_usages = vec![KeyUsagePurpose::KeyCertSign, KeyUsagePurpose::CrlSign];
    params
}

fn member(name: &str, days: u32) -> Result<CertificateParams, rcgen::Error> {
    let mut params = CertificateParams::new([NAME.to_owned()])?;
    params.distinguished_name.push(DnType::CommonName, name);
    params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
    params.extended_key_usages = vec![
        ExtendedKeyUsagePurpose::ServerAuth,
        ExtendedKeyUsagePurpose::ClientAuth,
    ];
    params.use_authority_key_identifier_extension = true;
    // A clock may be a little behind.
    params.not_before = time_now() - Duration::from_secs(3_600);
    params.not_after = time_now() + Duration::from_secs(u64::from(days) * 86_400);
    Ok(params)
}

fn time_now() -> time::OffsetDateTime {
    time::OffsetDateTime::now_utc()
}

/// Writes a file that was not there, for its owner alone.
fn write(path: &Path, text: &str) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)?.write_all(text.as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_builds_and_other_programs_are_refused() {
        let credentials = |build: &str| Credentials {
            identity: None,
            build: build.to_owned(),
        };
        let guard = credentials("1.2.3 (simulator 4)").guard();
        let asks = |agent: &str| {
            let mut request = Request::new(());
            request
                .metadata_mut()
                .insert("user-agent", agent.parse().unwrap());
            guard(request)
        };
        let ours = credentials("1.2.3 (simulator 4)").agent();
        assert!(asks(&format!("{ours} tonic/0.14.9")).is_ok());
        let theirs = credentials("1.2.3 (simulator 5)").agent();
        for agent in [&*theirs, "", "tonic/0.14.9", &ours[..ours.len() - 1]] {
            let refused = asks(agent).unwrap_err();
            assert_eq!(refused.code(), Code::PermissionDenied, "{agent}");
            assert!(refused.message().contains("1.2.3 (simulator 4)"));
        }
        assert!(guard(Request::new(())).is_err());
    }

    #[test]
    fn an_identity_is_issued_once_and_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let names = ["scheduler", "one"].map(str::to_owned);
        let files = issue(folder.path(), &names, 30).unwrap();
        let [scheduler, one] = [0, 1].map(|index| Identity::read(&files[index]).unwrap());
        assert_eq!(scheduler.authority, one.authority);
        assert!(scheduler.key != one.key && scheduler.certificate != one.certificate);
        assert!(!format!("{one:?}").contains("KEY"));
        // Nothing is replaced, and the authority stays.
        assert!(issue(folder.path(), &names[1..], 30).is_err());
        let later = issue(folder.path(), &["two".to_owned()], 30).unwrap();
        assert_eq!(Identity::read(&later[0]).unwrap().authority, one.authority);
        let half = folder.path().join("half.pem");
        fs::write(&half, &one.key).unwrap();
        for wrong in [
            half,
            folder.path().join(AUTHORITY[0]),
            folder.path().join("none"),
        ] {
            let error = Identity::read(&wrong).unwrap_err().to_string();
            assert!(error.contains(&*wrong.display().to_string()), "{error}");
        }
    }
}
