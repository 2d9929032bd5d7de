//! What the live page shows: frames of an episode, a candump log or a live bus.
//!
//! ```text
//! episode ─> pipeline ──┐                                        ┌─ server of `slipsense view`
//!                       ├─> Record ─> Frames, which answer to ───┤
//! candump ─> Receiver ──┘                                        └─ the page itself, with this crate as WebAssembly
//! ```
//!
//! One [`record`] layout carries all of them, so the page does not know where frames come from.

pub mod record;
pub mod frames;
pub mod source;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "wasm32")]
mod wasm;

const PAGE: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/page.css");
/// In the order in which they need each other.
const SCRIPTS: [&str; 4] = [
    include_str!("page/source.js"),
    include_str!("page/draw.js"),
    include_str!("page/session.js"),
    include_str!("page/page.js"),
];

/// The page in one piece; `module`: this crate as WebAssembly, Base64, for a page without a server.
pub fn page(module: Option<&str>) -> String {
    let module = module.map(|module| format!("<script>const MODULE = \"{module}\";</script>\n"));
    let scripts = SCRIPTS.iter().map(|script| format!("<script>\n{script}</script>\n"));
    let scripts: String = module.into_iter().chain(scripts).collect();
    let style = format!("<style>\n{STYLE}</style>");
    PAGE.replacen("<!-- style -->", &style, 1).replacen("<!-- scripts -->\n", &scripts, 1)
}
