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
    // Names come from users' files. Without `<` none of them can end the script.
    let card = card.to_string().replace('<', "\\u003c");
    // The card comes last, so that nothing in it is taken for a place to fill in.
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

#[cfg(test)]
mod tests {
    use super::page;
    use serde_json::json;

    #[test]
    fn no_name_gets_out_of_the_card() {
        let card = json!({"fields": ["</script><script>alert(1)</script>/*SCRIPT*/"]});
        let (html, policy) = page(&card, "n0nce");
        assert_eq!(
            html.matches("</script>").count(),
            2,
            "the card's and the script's"
        );
        assert_eq!(html.matches("<script nonce=\"n0nce\"").count(), 2);
        assert!(policy.contains("script-src 'nonce-n0nce';"));
    }
}
