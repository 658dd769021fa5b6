//! A network that is made up: connections in memory, each over a wire that delays, stalls or
//! breaks.

use std::{io, net::SocketAddr, time::Duration};

use axum::serve::Listener;
use tokio::{
    io::{
        AsyncRead, AsyncReadExt as _, AsyncWrite, AsyncWriteExt as _, DuplexStream, duplex, split,
    },
    sync::mpsc,
};

use crate::rng::SeededRng;

/// Where every client seems to be.
const CLIENT: SocketAddr =
    SocketAddr::new(std::net::IpAddr::V4(std::net::Ipv4Addr::LOCALHOST), 40_000);

/// The side of the clients.
#[derive(Clone)]
pub struct Network(mpsc::UnboundedSender<DuplexStream>);

/// The side of the server.
pub struct Connections(mpsc::UnboundedReceiver<DuplexStream>);

/// What a wire does to the bytes that go over it.
#[derive(Clone, Copy, Debug)]
pub struct Wire {
    /// So many bytes go at a time.
    pub piece: usize,
    /// So long after the ones before.
    pub delay: Duration,
    /// After so many bytes to the server, and so many back, it carries no more; where `breaks`,
    /// both ends learn of it.
    pub ends_after: [u64; 2],
    pub breaks: bool,
}

impl Wire {
    /// A wire without faults.
    pub const GOOD: Self = Self {
        piece: 1 << 16,
        delay: Duration::ZERO,
        ends_after: [u64::MAX; 2],
        breaks: false,
    };

    /// A wire as it may be in a world with faults: good, slow, or one that ends in the midst.
    pub fn any(rng: &mut SeededRng) -> Self {
        let mut wire = Self::GOOD;
        if rng.once_in(4) {
            wire.piece = 1 + rng.below(2_000) as usize;
            wire.delay = Duration::from_millis(rng.below(40));
        }
        if rng.once_in(5) {
            let direction = rng.below(2) as usize;
            wire.ends_after[direction] = rng.below(1_500);
            wire.breaks = !rng.once_in(4);
        }
        wire
    }
}

/// A network without connections.
pub fn network() -> (Network, Connections) {
    let (sender, receiver) = mpsc::unbounded_channel();
    (Network(sender), Connections(receiver))
}

impl Network {
    /// A connection to the server over such a wire.
    pub fn connect(&self, wire: Wire) -> io::Result<DuplexStream> {
        let (client, near) = duplex(1 << 14);
        let (far, server) = duplex(1 << 14);
        let refused = |_| io::Error::from(io::ErrorKind::ConnectionRefused);
        self.0.send(server).map_err(refused)?;
        tokio::spawn(carry(near, far, wire));
        Ok(client)
    }
}

/// Carries bytes both ways until the wire breaks, or both ends have gone.
async fn carry(near: DuplexStream, far: DuplexStream, wire: Wire) {
    let ((from_client, to_client), (from_server, to_server)) = (split(near), split(far));
    let there = carry_one_way(from_client, to_server, wire, wire.ends_after[0]);
    let back = carry_one_way(from_server, to_client, wire, wire.ends_after[1]);
    if wire.breaks {
        tokio::select! {
            biased;
            true = there => {}
            true = back => {}
            else => {}
        }
    } else {
        tokio::join!(there, back);
    }
}

/// Whether the wire broke.
async fn carry_one_way(
    mut from: impl AsyncRead + Unpin,
    mut to: impl AsyncWrite + Unpin,
    wire: Wire,
    mut left: u64,
) -> bool {
    let mut buffer = vec![0; wire.piece];
    loop {
        let Ok(count @ 1..) = from.read(&mut buffer).await else {
            let _ = to.shutdown().await;
            return false;
        };
        if !wire.delay.is_zero() {
            tokio::time::sleep(wire.delay).await;
        }
        let carried = left.min(count as u64) as usize;
        left -= carried as u64;
        if to.write_all(&buffer[..carried]).await.is_err() {
            return false;
        }
        if left == 0 {
            return if wire.breaks {
                true
            } else {
                std::future::pending().await
            };
        }
    }
}

impl Listener for Connections {
    type Io = DuplexStream;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (DuplexStream, SocketAddr) {
        match self.0.recv().await {
            Some(stream) => (stream, CLIENT),
            None => std::future::pending().await,
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        Ok(SocketAddr::from(([127, 0, 0, 1], 8801)))
    }
}
