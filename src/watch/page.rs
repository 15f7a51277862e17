//! The page: one HTML file that asks its server for the rest. Knows nothing of the run.

/// The page, and the policy that it comes with: nothing from elsewhere, and nothing runs but what
/// stands in it under `nonce`, a word that nobody else knows.
pub fn page(nonce: &str) -> (String, String) {
    let html = include_str!("page/page.html")
        .replace("NONCE", nonce)
        .replace("/*STYLE*/", include_str!("page/style.css"))
        .replace("/*SCRIPT*/", include_str!("page/script.js"));
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; \
         connect-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; \
         frame-ancestors 'none'"
    );
    (html, policy)
}
