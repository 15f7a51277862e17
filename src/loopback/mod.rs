//! Servers on this machine's loopback: where they listen and who may ask. Knows nothing of what is
//! served.

pub mod guard;

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;

use tokio::net::TcpListener;
use tokio::runtime::Runtime;

use guard::Guard;

/// Threads that serve; rendering and stages have their own.
const SERVING: usize = 2;

/// A socket that listens, with the threads that will serve it.
pub struct Loopback {
    /// The threads.
    pub runtime: Runtime,
    /// The socket.
    pub listener: TcpListener,
    /// Who may ask.
    pub guard: Arc<Guard>,
}

impl Loopback {
    /// Listens on any free port where `port` is 0.
    ///
    /// # Errors
    /// A port that is taken, or a system that has no threads or random numbers to give.
    pub fn new(port: u16) -> std::io::Result<Self> {
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(SERVING)
            .enable_all()
            .build()?;
        // Never another address: the page is for this machine alone.
        let address = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        let listener = runtime.block_on(TcpListener::bind(address))?;
        let guard = Guard::new(listener.local_addr()?).map_err(std::io::Error::other)?;
        Ok(Self {
            runtime,
            listener,
            guard: Arc::new(guard),
        })
    }
}
