//! Who may ask: whoever knows the token, by a name of this machine's loopback. Knows nothing of
//! what is served.

use std::net::SocketAddr;
use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{HOST, HeaderMap, HeaderName, ORIGIN};
use axum::http::{HeaderValue, StatusCode};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use subtle::ConstantTimeEq;

/// Longer addresses are none of ours.
const LONGEST_ADDRESS: usize = 256;
/// What every answer says, so that a page stays alone with this server: nothing is kept, passed on,
/// framed, or fetched from elsewhere.
const HEADERS: [(HeaderName, &str); 4] = [
    (HeaderName::from_static("cache-control"), "no-store"),
    (HeaderName::from_static("referrer-policy"), "no-referrer"),
    (HeaderName::from_static("x-content-type-options"), "nosniff"),
    (
        HeaderName::from_static("cross-origin-resource-policy"),
        "same-origin",
    ),
];

/// What lets a request in.
pub struct Guard {
    token: String,
    hosts: [String; 2],
}

impl Guard {
    /// A guard of the server at this address, with a new token of 128 bits.
    ///
    /// # Errors
    /// A system without random numbers.
    pub fn new(address: SocketAddr) -> Result<Self, getrandom::Error> {
        let port = address.port();
        Ok(Self {
            token: random_word()?,
            hosts: ["127.0.0.1", "localhost"].map(|name| format!("{name}:{port}")),
        })
    }

    /// The address of the page.
    pub fn url(&self) -> String {
        format!("http://{}/{}/", self.hosts[0], self.token)
    }

    /// Whether a request may come in. A page elsewhere whose name was made to lead here asks for
    /// that name, and one that knows this address says where it comes from.
    fn lets_in(&self, path: &str, headers: &HeaderMap) -> bool {
        // Addresses are `/TOKEN/..`, and before the first slash stands nothing.
        let token = path.split('/').nth(1).unwrap_or_default();
        // In constant time, so that nobody can find the token letter by letter.
        let knows = token.as_bytes().ct_eq(self.token.as_bytes());
        // Against DNS rebinding: a foreign name that resolves to 127.0.0.1 is still sent as the
        // host.
        let host = headers.get(HOST).and_then(|host| host.to_str().ok());
        let origin = headers.get(ORIGIN).map(|origin| {
            let origin = origin.to_str().unwrap_or_default();
            // An origin that is `null` or no http address becomes the empty text, which is none of
            // ours.
            origin.strip_prefix("http://").unwrap_or_default()
        });
        let is_ours = |name: &str| self.hosts.iter().any(|host| host == name);
        bool::from(knows) && host.is_some_and(is_ours) && origin.is_none_or(is_ours)
    }
}

/// 128 random bits of the system, in hexadecimal digits.
///
/// # Errors
/// A system without random numbers.
pub fn random_word() -> Result<String, getrandom::Error> {
    let mut bits = [0; 16];
    getrandom::fill(&mut bits)?;
    Ok(bits.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Answers with nothing to whoever may not ask, before anything else is looked at.
pub async fn watch(State(guard): State<Arc<Guard>>, request: Request, next: Next) -> Response {
    let uri = request.uri();
    let length = uri.path_and_query().map_or(0, |all| all.as_str().len());
    let mut answer = if !guard.lets_in(uri.path(), request.headers()) {
        // Not `forbidden`: to whoever may not ask, there is nothing here.
        StatusCode::NOT_FOUND.into_response()
    } else if length > LONGEST_ADDRESS {
        StatusCode::URI_TOO_LONG.into_response()
    } else {
        next.run(request).await
    };
    // On refusals too, which a browser could otherwise keep.
    for (name, value) in HEADERS {
        let value = HeaderValue::from_static(value);
        answer.headers_mut().insert(name, value);
    }
    answer
}
