//! What can go wrong with a remote, in words that hold no credentials.

use std::error::Error;

use crate::store::error::StoreError;

/// What went wrong with a remote.
#[derive(Debug, thiserror::Error)]
pub enum RemoteFault {
    /// It does not answer, or not with what was asked for.
    #[error("{}", cause(.0))]
    Remote(#[from] object_store::Error),
    /// What it has is not what it should be.
    #[error("{0}")]
    Damaged(String),
    /// The local store cannot be used.
    #[error(transparent)]
    Local(#[from] StoreError),
}

impl RemoteFault {
    /// Whether the same question may be answered when it is asked again.
    pub fn may_pass(&self) -> bool {
        use object_store::Error::{Generic, JoinError};
        // The client has no variant of its own for lost connections and servers' errors: they are
        // `Generic`.
        matches!(self, Self::Remote(Generic { .. } | JoinError { .. }))
    }
}

/// What is said of an endpoint without encryption, which is refused unless it is asked for.
const NO_TLS: &str = "the endpoint is plain http; give an https address, or set AWS_ALLOW_HTTP=true where traffic may be read";

/// The cause in a few words. Answers of servers may quote request headers, so nothing of their text
/// is repeated.
fn cause(error: &object_store::Error) -> String {
    use object_store::Error::{NotFound, PermissionDenied, Unauthenticated};
    match error {
        PermissionDenied { .. } => "permission denied".to_owned(),
        Unauthenticated { .. } => "the credentials in the environment are not taken".to_owned(),
        NotFound { .. } => "there is no such bucket or folder".to_owned(),
        error => match root(error).to_string() {
            // Known by its words, since the error has no kind of its own. Other words would be
            // shown as they are.
            text if text.contains("scheme is not") => NO_TLS.to_owned(),
            text => first_words(&text),
        },
    }
}

fn root<'e>(error: &'e (dyn Error + 'static)) -> &'e (dyn Error + 'static) {
    // The outer errors only say which request it was. The innermost says what happened.
    let mut deepest = error;
    while let Some(source) = deepest.source() {
        deepest = source;
    }
    deepest
}

/// Up to where a quotation, a page or a second line begins.
fn first_words(text: &str) -> String {
    // Pages and quotations come from the server, and may hold parts of the request.
    let end = text.find(['\n', '<', '{', '"']).unwrap_or(text.len());
    text[..end].trim_end_matches([' ', ':', ',']).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_that_a_server_says_is_repeated() {
        let text = "Server returned non-2xx status code: 403 Forbidden: <Error><StringToSign>AKIA";
        assert_eq!(
            first_words(text),
            "Server returned non-2xx status code: 403 Forbidden"
        );
        assert_eq!(
            first_words("connection refused (os error 111)"),
            "connection refused (os error 111)"
        );
    }
}
