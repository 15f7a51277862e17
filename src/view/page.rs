//! The page: one HTML file that needs nothing else. Knows nothing of what it asks for later.

use serde_json::Value;

/// What the page runs, one behind the other in one script.
const SCRIPT: &str = concat!(
    "\"use strict\";\n",
    include_str!("page/camera.js"),
    include_str!("page/asking.js"),
    include_str!("page/drawing.js"),
    include_str!("page/poses.js"),
    include_str!("page/controls.js"),
);

/// The page of what a card tells, and the policy that it comes with: nothing from elsewhere, and
/// nothing runs but what stands in it under `nonce`, a word that nobody else knows.
pub fn page(card: &Value, nonce: &str) -> (String, String) {
    let card = card.to_string().replace('<', "\\u003c");
    let html = include_str!("page/page.html")
        .replace("NONCE", nonce)
        .replace("/*STYLE*/", include_str!("page/style.css"))
        .replace("/*SCRIPT*/", SCRIPT)
        .replace("/*CARD*/", &card);
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; \
         connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; \
         frame-ancestors 'none'"
    );
    (html, policy)
}
