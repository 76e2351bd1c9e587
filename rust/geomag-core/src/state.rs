//! Saved state: any streaming object to bytes and back, to the last bit.

use serde::{Serialize, de::DeserializeOwned};

use crate::error::{Error, Result};

/// Written before every state, raised when a layout changes.
const FORMAT: &str = "geomag-1";

/// The object as bytes (postcard, with a format mark and the object's name before it).
///
/// # Errors
/// [`Error::State`] where the object cannot be written.
pub fn save<T: Serialize>(what: &str, object: &T) -> Result<Vec<u8>> {
    postcard::to_stdvec(&(FORMAT, what, object)).map_err(|e| Error::State { what: what.into(), detail: e.to_string() })
}

/// The object back from [`save`].
///
/// # Errors
/// [`Error::State`] for bytes of another format, another object, cut short or damaged.
pub fn load<T: DeserializeOwned>(what: &str, bytes: &[u8]) -> Result<T> {
    let refuse = |detail: String| Error::State { what: what.into(), detail };
    let (format, rest) =
        postcard::take_from_bytes::<&str>(bytes).map_err(|e| refuse(format!("not a saved state ({e})")))?;
    if format != FORMAT {
        return Err(refuse(format!("needed format {FORMAT}, got '{format}'")));
    }
    let (name, rest) = postcard::take_from_bytes::<&str>(rest).map_err(|e| refuse(e.to_string()))?;
    if name != what {
        return Err(refuse(format!("these bytes hold a {name}")));
    }
    let (object, rest) = postcard::take_from_bytes(rest).map_err(|e| refuse(format!("damaged ({e})")))?;
    if rest.is_empty() { Ok(object) } else { Err(refuse(format!("{} bytes too many", rest.len()))) }
}
