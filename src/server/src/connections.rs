//! Accepting connections: so many, each with a time for the head of its requests and for reading
//! what it asked for; and letting them end.

use std::{net::SocketAddr, sync::Arc, time::Duration};

use axum::{Router, body::Body, http::Request, serve::Listener};
use hyper::body::Incoming;
use hyper_util::{
    rt::{TokioExecutor, TokioIo, TokioTimer},
    server::conn::auto::Builder,
    service::TowerToHyperService,
};
use tokio::{
    io::{AsyncRead, AsyncWrite},
    sync::{OwnedSemaphorePermit, Semaphore},
};
use tokio_io_timeout::TimeoutStream;
use tokio_rustls::TlsAcceptor;
use tokio_util::{
    sync::CancellationToken,
    task::{TaskTracker, task_tracker::TaskTrackerToken},
};
use tower::ServiceExt as _;

use crate::{service::App, tls::Certificate};

/// How long open requests may take to end after the call to stop.
const GRACE: Duration = Duration::from_secs(10);

/// The address of a client.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Client(pub SocketAddr);

/// The place of a connection among all, for what goes on after its request was answered: held
/// until the last clone is dropped.
#[derive(Clone)]
pub(crate) struct ConnectionPlace {
    _held: Arc<Held>,
}

/// What a connection takes up.
struct Held {
    _place: OwnedSemaphorePermit,
    _counted: Counted,
    /// The server waits for it when it stops.
    _task: TaskTrackerToken,
}

/// A connection in the metrics, as long as it lives.
struct Counted(Arc<App>);

impl Counted {
    fn new(app: &Arc<App>) -> Self {
        app.metrics.connections.inc();
        Self(app.clone())
    }
}

impl Drop for Counted {
    fn drop(&mut self) {
        self.0.metrics.connections.dec();
    }
}

/// What a connection is made of, encrypted or not.
trait Stream: AsyncRead + AsyncWrite + Send + Unpin {}

impl<T: AsyncRead + AsyncWrite + Send + Unpin> Stream for T {}

/// Serves until `closing`, then lets open requests end.
pub(crate) async fn serve<L: Listener<Addr = SocketAddr>>(
    mut listener: L,
    router: Router,
    app: Arc<App>,
    closing: CancellationToken,
) {
    let places = Arc::new(Semaphore::new(app.config.limits.connections));
    let tasks = TaskTracker::new();
    let acceptor = app.certificate.as_ref().map(Certificate::acceptor);
    loop {
        // Who finds no place waits outside, in the system's queue.
        let place = tokio::select! {
            place = places.clone().acquire_owned() => place.expect("the places are never closed"),
            () = closing.cancelled() => break,
        };
        let (stream, address) = tokio::select! {
            // Out of file descriptors, axum's listener logs it and tries again a second later.
            accepted = listener.accept() => accepted,
            () = closing.cancelled() => break,
        };
        let (router, app, closing) = (router.clone(), app.clone(), closing.clone());
        let acceptor = acceptor.clone();
        let place = ConnectionPlace {
            _held: Arc::new(Held {
                _place: place,
                _counted: Counted::new(&app),
                _task: tasks.token(),
            }),
        };
        tasks.spawn(async move {
            let held = place.clone();
            let service = tower::service_fn(move |mut request: Request<Incoming>| {
                request.extensions_mut().insert(Client(address));
                request.extensions_mut().insert(place.clone());
                router.clone().oneshot(request.map(Body::new))
            });
            let mut builder = Builder::new(TokioExecutor::new()).http1_only();
            builder
                .http1()
                .timer(TokioTimer::new())
                .header_read_timeout(app.read_patience());
            // Who asks and does not read would have its place, and what it asked for
            // in memory, for ever.
            let mut stream = TimeoutStream::new(stream);
            stream.set_write_timeout(Some(app.read_patience()));
            let stream = Box::pin(stream);
            let Some(stream) = secured(&app, stream, acceptor, address, &closing).await else {
                return;
            };
            let service = TowerToHyperService::new(service);
            let connection = builder.serve_connection_with_upgrades(TokioIo::new(stream), service);
            tokio::pin!(connection);
            let ended = tokio::select! {
                ended = &mut connection => ended,
                () = closing.cancelled() => {
                    connection.as_mut().graceful_shutdown();
                    connection.await
                }
            };
            if let Err(error) = ended {
                tracing::debug!(%error, client = %address, "a connection broke off");
            }
            drop(held);
        });
    }
    tasks.close();
    if tokio::time::timeout(GRACE, tasks.wait()).await.is_err() {
        tracing::warn!(open = tasks.len(), "some requests did not finish in time");
    }
}

/// The stream of a connection after its TLS handshake, if the service has a certificate; `None` if
/// the handshake fails, or the service stops before.
async fn secured<S: AsyncRead + AsyncWrite + Send + Unpin + 'static>(
    app: &App,
    stream: S,
    acceptor: Option<TlsAcceptor>,
    address: SocketAddr,
    closing: &CancellationToken,
) -> Option<Box<dyn Stream>> {
    let Some(acceptor) = acceptor else {
        return Some(Box::new(stream));
    };
    let shaken = tokio::select! {
        shaken = tokio::time::timeout(app.read_patience(), acceptor.accept(stream)) => shaken,
        () = closing.cancelled() => return None,
    };
    match shaken {
        Ok(Ok(stream)) => Some(Box::new(stream)),
        Ok(Err(error)) => {
            tracing::debug!(%error, client = %address, "no TLS handshake");
            None
        }
        Err(_) => None,
    }
}
