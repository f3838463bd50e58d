//! The page's files, which `npm run build` in `host/bedside/web` makes; they are part of the program.

use axum::http::header::CONTENT_TYPE;
use axum::response::{IntoResponse, Response};

/// A file.
pub struct File {
    /// Path of the request.
    pub path: &'static str,
    kind: &'static str,
    content: &'static [u8],
}

/// All files.
pub const FILES: [File; 3] = [
    File {
        path: "/",
        kind: "text/html; charset=utf-8",
        content: include_bytes!("../../web/dist/index.html"),
    },
    File {
        path: "/app.js",
        kind: "text/javascript; charset=utf-8",
        content: include_bytes!("../../web/dist/app.js"),
    },
    File {
        path: "/app.css",
        kind: "text/css; charset=utf-8",
        content: include_bytes!("../../web/dist/app.css"),
    },
];

impl File {
    /// The response with the file.
    pub fn response(&self) -> Response {
        ([(CONTENT_TYPE, self.kind)], self.content).into_response()
    }
}
