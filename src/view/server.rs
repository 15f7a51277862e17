//! The page and what it asks for, by HTTP. Renders nothing itself.

use std::convert::Infallible;
use std::future::IntoFuture;
use std::io::ErrorKind;
use std::pin::pin;
use std::sync::Arc;
use std::thread::JoinHandle;

use axum::body::{Body, Bytes};
use axum::extract::{DefaultBodyLimit, Path, State};
use axum::http::StatusCode;
use axum::http::header::{CONTENT_SECURITY_POLICY, CONTENT_TYPE};
use axum::response::{Html, IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Router, middleware};
use compute::Device;
use futures_util::future::{BoxFuture, Either, FutureExt, select};
use futures_util::stream;
use serde::de::DeserializeOwned;
use tokio::net::TcpListener;
use tokio::runtime::Runtime;
use tokio::sync::{mpsc, oneshot};

use super::look::{self, Look};
use super::newest::Newest;
use super::page;
use super::painter::{MOST_FRAMES, Order, Painter};
use super::picture::{self, ImageFormat};
use super::subject::Subject;
use crate::loopback::Loopback;
use crate::loopback::guard::{self, Guard};

/// The largest body of a request: a long path.
const MOST_BYTES: usize = 4 << 20;

/// A server that listens, and the page's address.
pub struct Server {
    runtime: Runtime,
    listener: TcpListener,
    guard: Arc<Guard>,
    /// Ends when the user interrupts the program.
    interrupted: BoxFuture<'static, std::io::Result<()>>,
}

/// What all handlers share.
struct Site {
    subject: Arc<Subject>,
    orders: Arc<Newest<Order>>,
}

impl Server {
    /// Listens on this machine's loopback, on any free port where `port` is 0.
    ///
    /// # Errors
    /// A port that is taken, or a system that has no threads or random numbers to give.
    pub fn new(port: u16) -> std::io::Result<Self> {
        let Loopback {
            runtime,
            listener,
            guard,
        } = Loopback::new(port)?;
        let mut interrupted = tokio::signal::ctrl_c().boxed();
        // It listens from its first poll on, and whoever reads the address may interrupt at once.
        let ended = runtime.block_on(async { (&mut interrupted).now_or_never() });
        if let Some(ended) = ended {
            return Err(ended.err().unwrap_or(ErrorKind::Interrupted.into()));
        }
        Ok(Self {
            runtime,
            listener,
            guard,
            interrupted,
        })
    }

    /// The page's address, token and all.
    pub fn url(&self) -> String {
        self.guard.url()
    }

    /// Serves until the user interrupts it.
    ///
    /// # Errors
    /// A system that gives no more connections.
    pub fn run(self, subject: Subject, device: Device) -> std::io::Result<()> {
        let Self {
            runtime,
            listener,
            guard,
            interrupted,
        } = self;
        let site = Arc::new(Site {
            subject: Arc::new(subject),
            orders: Arc::default(),
        });
        let (painter, over) = site.painter(device);
        let service = axum::serve(listener, router(site.clone(), guard));
        let served = runtime.block_on(async {
            let serving = pin!(service.into_future());
            // A painter that ends before it is told to has a bug, which is raised below.
            match select(serving, select(interrupted, over)).await {
                Either::Left((served, _)) => served,
                Either::Right(_) => Ok(()),
            }
        });
        // The painter waits for orders: only now does it end and can be joined.
        site.orders.close();
        if let Err(bug) = painter.join() {
            std::panic::resume_unwind(bug);
        }
        runtime.shutdown_background();
        served
    }
}

impl Site {
    /// A thread that renders what is ordered, and what ends when it does.
    fn painter(&self, device: Device) -> (JoinHandle<()>, oneshot::Receiver<Infallible>) {
        let subject = self.subject.clone();
        let orders = self.orders.clone();
        // Nothing is ever sent. The channel ends with the thread, also if that panics.
        let (at_work, over) = oneshot::channel();
        let painter = std::thread::spawn(move || {
            Painter::new(&subject, &device).work(&orders);
            drop(at_work);
        });
        (painter, over)
    }
}

fn router(site: Arc<Site>, guard: Arc<Guard>) -> Router {
    Router::new()
        .route("/{token}/", get(html))
        .route("/{token}/look", post(look))
        .route("/{token}/path", post(path))
        .route("/{token}/photo/{number}", get(photo))
        .layer(DefaultBodyLimit::max(MOST_BYTES))
        // The last layer is the outermost: nothing of a request is read before its token is known.
        .layer(middleware::from_fn_with_state(guard, guard::watch))
        .with_state(site)
}

async fn html(State(site): State<Arc<Site>>) -> Result<Response, StatusCode> {
    // Drawn for each page, so that no script that got into one can know it.
    let nonce = guard::random_word().map_err(|_| StatusCode::INTERNAL_SERVER_ERROR)?;
    let (html, policy) = page::page(&site.subject.card(), &nonce);
    Ok(([(CONTENT_SECURITY_POLICY, policy)], Html(html)).into_response())
}

/// Frames, one behind the other, as they are rendered.
async fn look(State(site): State<Arc<Site>>, body: Bytes) -> Result<Response, Problem> {
    // Checked before it is ordered: the painter has nobody to tell of a mistake.
    let look: Look = read(&body)?;
    let camera = look.camera(&site.subject).map_err(Problem)?;
    // Room for all frames: the painter must not wait for a slow page.
    let (reply, frames) = mpsc::channel(MOST_FRAMES);
    site.orders.put(Order {
        look,
        camera,
        reply,
    });
    let frames = stream::unfold(frames, |mut frames| async move {
        let frame = frames.recv().await?;
        Some((Ok::<_, Infallible>(frame), frames))
    });
    let kind = [(CONTENT_TYPE, "application/octet-stream")];
    Ok((kind, Body::from_stream(frames)).into_response())
}

/// A file that `Render(path: File)` reads.
async fn path(State(site): State<Arc<Site>>, body: Bytes) -> Result<Response, Problem> {
    let path: look::Path = read(&body)?;
    let cameras = path.cameras(&site.subject).map_err(Problem)?;
    let kind = [(CONTENT_TYPE, "application/json")];
    Ok((kind, scene::path_text(&cameras)).into_response())
}

async fn photo(
    State(site): State<Arc<Site>>,
    Path((_, number)): Path<(String, usize)>,
) -> Result<Response, StatusCode> {
    // Encoding takes a while, and the threads that serve must not wait for it.
    let encode = move || {
        let view = site.subject.photos.get(number)?;
        let size = [view.camera.width, view.camera.height];
        picture::encode(&picture::photo(view), size, ImageFormat::Png).ok()
    };
    let encoded = tokio::task::spawn_blocking(encode).await;
    let file = encoded.ok().flatten().ok_or(StatusCode::NOT_FOUND)?;
    Ok(([(CONTENT_TYPE, ImageFormat::Png.mime())], file).into_response())
}

/// A request that asks for what there is not.
struct Problem(String);

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        (StatusCode::BAD_REQUEST, self.0).into_response()
    }
}

fn read<T: DeserializeOwned>(body: &[u8]) -> Result<T, Problem> {
    serde_json::from_slice(body).map_err(|error| Problem(error.to_string()))
}
