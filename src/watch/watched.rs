//! Another way of telling, and a page beside it. Knows nothing of HTTP.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::dashboard::Dashboard;
use super::server::Server;
use crate::store::view::View;
use crate::terminal::output::tell;
use crate::terminal::progress::{Event, Progress};

/// How often it is looked whether a page is still open once the run is over.
const PAUSE: Duration = Duration::from_millis(200);

/// A way of telling, and the page.
pub struct Watched {
    told: Box<dyn Progress>,
    dashboard: Arc<Dashboard>,
    server: Server,
    /// Whether the user has asked to stop.
    cancelled: Arc<AtomicBool>,
}

impl Watched {
    /// Tells `told` all, and shows it on a page, whose address is printed first.
    ///
    /// # Errors
    /// A system that has no port, threads or random numbers to give.
    pub fn beside(
        told: Box<dyn Progress>,
        (pipeline, names): (&str, Vec<String>),
        view: &View,
        cancelled: &Arc<AtomicBool>,
    ) -> std::io::Result<Self> {
        let dashboard = Arc::new(Dashboard::new(pipeline, names));
        // Before the first stage, so that a page which cannot be served is known before hours of
        // work.
        let server = Server::new(dashboard.clone(), view.clone())?;
        tell(&format_args!("watch it at {}", server.url));
        Ok(Self {
            told,
            dashboard,
            server,
            cancelled: cancelled.clone(),
        })
    }

    /// Whether somebody still looks, and has not asked to stop.
    fn is_wanted(&self) -> bool {
        self.dashboard.watchers() > 0 && !self.cancelled.load(Ordering::Relaxed)
    }
}

impl Progress for Watched {
    fn event(&mut self, event: &Event) {
        self.dashboard.note(event);
        self.told.event(event);
    }
}

impl Drop for Watched {
    /// The page stays for as long as somebody looks: pictures are fetched when they are clicked on.
    fn drop(&mut self) {
        self.dashboard.end("The run is over.");
        if self.is_wanted() {
            let url = &self.server.url;
            tell(&format_args!(
                "the page stays until it is closed, or until Ctrl-C: {url}"
            ));
        }
        if self.dashboard.watchers() > 0 {
            // Time for the last change to reach them.
            std::thread::sleep(PAUSE);
        }
        while self.is_wanted() {
            std::thread::sleep(PAUSE);
        }
    }
}
