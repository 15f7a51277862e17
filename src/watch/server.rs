//! The page of a run, by HTTP. Knows nothing of how the run goes but what the dashboard says.

use std::convert::Infallible;
use std::path::{Component, Path as File};
use std::sync::Arc;
use std::time::Duration;

use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::http::header::{CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::get;
use axum::{Router, middleware};
use futures_util::Stream;
use futures_util::stream;
use tokio::runtime::Runtime;
use tokio::sync::broadcast::Receiver;
use tokio::sync::broadcast::error::RecvError;

use super::dashboard::Dashboard;
use super::page;
use super::pictures;
use crate::loopback::{Loopback, guard};
use crate::store::view::View;

/// How soon it shows that a page was closed.
const PULSE: Duration = Duration::from_secs(1);

/// A server that serves until it is dropped.
pub struct Server {
    runtime: Option<Runtime>,
    /// The page's address, token and all.
    pub url: String,
}

/// What all handlers share.
struct Site {
    dashboard: Arc<Dashboard>,
    view: View,
}

impl Server {
    /// Serves a dashboard, and the pictures of its stages in `view`.
    ///
    /// # Errors
    /// A system that has no port, threads or random numbers to give.
    pub fn new(dashboard: Arc<Dashboard>, view: View) -> std::io::Result<Self> {
        let Loopback {
            runtime,
            listener,
            guard,
        } = Loopback::new(0)?;
        let url = guard.url();
        let site = Arc::new(Site { dashboard, view });
        let service = axum::serve(listener, router(site, guard));
        runtime.spawn(async move { service.await });
        Ok(Self {
            runtime: Some(runtime),
            url,
        })
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(runtime) = self.runtime.take() {
            // Without waiting: a stream of changes lasts for as long as its page is open.
            runtime.shutdown_background();
        }
    }
}

fn router(site: Arc<Site>, guard: Arc<guard::Guard>) -> Router {
    Router::new()
        .route("/{token}/", get(html))
        .route("/{token}/changes", get(changes))
        .route("/{token}/pictures/{stage}", get(list))
        .route("/{token}/pictures/{stage}/{output}/{file}", get(picture))
        // The outermost layer: no handler sees a request before its token is known.
        .layer(middleware::from_fn_with_state(guard, guard::watch))
        .with_state(site)
}

async fn html() -> Result<Response, StatusCode> {
    // Drawn for each page: a script that got into one from outside could not know the word.
    let nonce = guard::random_word().map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)?;
    let (html, policy) = page::page(&nonce);
    Ok(([(CONTENT_SECURITY_POLICY, policy)], Html(html)).into_response())
}

/// The whole dashboard, then its changes; one that fell too far behind gets the whole again.
async fn changes(
    State(site): State<Arc<Site>>,
) -> Sse<impl Stream<Item = Result<Event, Infallible>>> {
    let (whole, changes) = site.dashboard.look();
    let state = (Some(whole), changes, site);
    let next = |(whole, changes, site): (Option<String>, Receiver<String>, Arc<Site>)| async {
        let (text, changes) = match whole {
            Some(whole) => (whole, changes),
            None => change(changes, &site.dashboard).await?,
        };
        Some((Ok(Event::default().data(text)), (None, changes, site)))
    };
    // That a page was closed shows only when something is sent to it.
    Sse::new(stream::unfold(state, next)).keep_alive(KeepAlive::new().interval(PULSE))
}

async fn change(
    mut changes: Receiver<String>,
    dashboard: &Dashboard,
) -> Option<(String, Receiver<String>)> {
    match changes.recv().await {
        Ok(change) => Some((change, changes)),
        // Single changes are lost by now, so only the whole is right.
        Err(RecvError::Lagged(_)) => Some(dashboard.look()),
        Err(RecvError::Closed) => None,
    }
}

async fn list(
    State(site): State<Arc<Site>>,
    Path((_, stage)): Path<(String, String)>,
) -> Result<Response, StatusCode> {
    if !site.dashboard.has(&stage) {
        return Err(StatusCode::NOT_FOUND);
    }
    // Reading folders blocks, and two threads serve all pages.
    let list = move || serde_json::to_string(&pictures::list(&site.view.stage(&stage))).ok();
    let listed = tokio::task::spawn_blocking(list).await.ok().flatten();
    let listed = listed.ok_or(StatusCode::INTERNAL_SERVER_ERROR)?;
    Ok(([(CONTENT_TYPE, "application/json")], listed).into_response())
}

async fn picture(
    State(site): State<Arc<Site>>,
    Path((_, stage, output, file)): Path<(String, String, String, String)>,
) -> Result<Response, StatusCode> {
    // Nothing but what lies in the stage's folder: no `..`, no path in the place of a name.
    let is_name = |name: &str| {
        let mut parts = File::new(name).components();
        matches!(
            (parts.next(), parts.next()),
            (Some(Component::Normal(_)), None)
        )
    };
    if !site.dashboard.has(&stage) || !is_name(&output) || !is_name(&file) {
        return Err(StatusCode::NOT_FOUND);
    }
    let read = move || pictures::png(&site.view.output(&stage, &output).join(&file));
    let png = tokio::task::spawn_blocking(read).await.ok().flatten();
    let png = png.ok_or(StatusCode::NOT_FOUND)?;
    Ok(([(CONTENT_TYPE, "image/png")], png).into_response())
}
