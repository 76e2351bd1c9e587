//! Saved state: any streaming object to bytes and back, to the last bit.
//!
//! The bytes are a format mark, the object's name, the length and the checksum of what follows, and the object (postcard). Nothing
//! comes back but through [`load`], and [`load`] asks [`Saved::check`]: bytes give an error or an object that its own constructor
//! could have made. Vectors grow as their elements are read, so that a false length takes no memory.

use serde::{Serialize, de::DeserializeOwned};

use crate::error::{Error, Result};

/// Written before every state, raised when a layout changes.
const FORMAT: &str = "geomag-2";

/// What can be saved and comes back checked.
pub trait Saved: Serialize + DeserializeOwned {
    /// The name before the bytes, and in errors.
    const NAME: &'static str;

    /// Refuses contents that no object of this kind can have. Everything that later code relies on is asked here.
    ///
    /// # Errors
    /// Any; [`load`] makes it an [`Error::State`].
    fn check(&self) -> Result<()>;
}

/// The object as bytes.
///
/// # Errors
/// [`Error::State`] where the object cannot be written.
pub fn save<T: Saved>(object: &T) -> Result<Vec<u8>> {
    let refuse = |e: postcard::Error| Error::State { what: T::NAME.into(), detail: e.to_string() };
    let body = postcard::to_stdvec(object).map_err(refuse)?;
    let mut bytes = postcard::to_stdvec(&(FORMAT, T::NAME, body.len() as u64, checksum(&body))).map_err(refuse)?;
    bytes.extend_from_slice(&body);
    Ok(bytes)
}

/// The object back from [`save`].
///
/// # Errors
/// [`Error::State`] for bytes of another format, another object, cut short or damaged, or whose contents no such object can have.
pub fn load<T: Saved>(bytes: &[u8]) -> Result<T> {
    let refuse = |detail: String| Error::State { what: T::NAME.into(), detail };
    let (format, rest) =
        postcard::take_from_bytes::<&str>(bytes).map_err(|e| refuse(format!("not a saved state ({e})")))?;
    if format != FORMAT {
        return Err(refuse(format!("needed format {FORMAT}, got '{format}'")));
    }
    let damaged = |e: postcard::Error| refuse(format!("damaged ({e})"));
    let (name, rest) = postcard::take_from_bytes::<&str>(rest).map_err(damaged)?;
    if name != T::NAME {
        return Err(refuse(format!("these bytes hold a {name}")));
    }
    let ((length, sum), body) = postcard::take_from_bytes::<(u64, u64)>(rest).map_err(damaged)?;
    if length != body.len() as u64 {
        return Err(refuse(format!("needed {length} bytes, got {}", body.len())));
    }
    if sum != checksum(body) {
        return Err(refuse("damaged (its checksum is another)".into()));
    }
    let (object, rest) = postcard::take_from_bytes::<T>(body).map_err(damaged)?;
    if !rest.is_empty() {
        return Err(refuse(format!("{} bytes too many", rest.len())));
    }
    object.check().map_err(|e| refuse(e.to_string()))?;
    Ok(object)
}

/// FNV-1a, 64 bits (Fowler, Noll and Vo): finds what storage and transport do to bytes, no more.
fn checksum(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |sum, b| (sum ^ u64::from(*b)).wrapping_mul(0x0100_0000_01b3))
}

/// A matrix in a saved state, for `#[serde(with)]`: nalgebra multiplies the shape that the bytes tell without asking whether it can.
pub(crate) mod matrix {
    use nalgebra::DMatrix;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error};

    pub fn serialize<S: Serializer>(matrix: &DMatrix<f64>, to: S) -> Result<S::Ok, S::Error> {
        (matrix.as_slice(), matrix.nrows(), matrix.ncols()).serialize(to)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<DMatrix<f64>, D::Error> {
        let (values, rows, columns) = <(Vec<f64>, usize, usize)>::deserialize(from)?;
        if rows.checked_mul(columns) != Some(values.len()) {
            return Err(D::Error::custom(format!("a matrix of {rows} x {columns} from {} numbers", values.len())));
        }
        Ok(DMatrix::from_vec(rows, columns, values))
    }
}

#[cfg(test)]
mod tests {
    use serde::{Deserialize, Serialize};

    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Even(Vec<u32>);

    impl Saved for Even {
        const NAME: &'static str = "Even";

        fn check(&self) -> Result<()> {
            match self.0.iter().find(|n| **n % 2 == 1) {
                None => Ok(()),
                Some(n) => Err(Error::invalid("number", "an even one", n)),
            }
        }
    }

    #[test]
    fn what_no_object_can_hold_does_not_come_back() {
        let bytes = save(&Even(vec![2, 4])).unwrap();
        assert_eq!(load::<Even>(&bytes).unwrap(), Even(vec![2, 4]));
        let odd = save(&Even(vec![2, 3])).unwrap();
        assert_eq!(
            load::<Even>(&odd).unwrap_err().to_string(),
            "saved state of Even: number: needed an even one, got 3"
        );
        for k in 0..bytes.len() {
            let mut bent = bytes.clone();
            bent[k] ^= 0x10;
            assert!(matches!(load::<Even>(&bent), Err(Error::State { .. })), "byte {k}");
            assert!(load::<Even>(&bytes[..k]).is_err());
        }
    }

    #[test]
    fn a_false_length_takes_no_memory() {
        let body = postcard::to_stdvec(&(u64::MAX >> 1)).unwrap();
        let mut bytes = postcard::to_stdvec(&(FORMAT, "Even", body.len() as u64, checksum(&body))).unwrap();
        bytes.extend_from_slice(&body);
        assert!(load::<Even>(&bytes).is_err());
    }
}
