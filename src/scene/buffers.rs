//! glTF's bytes: the GLB container, buffers, and accessors read with every range checked.
//!
//! The gltf crate's own readers answer "no such thing" to an accessor that reaches outside its
//! buffer and panic on short sparse data; here each accessor is judged and named.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use gltf::accessor::sparse::IndexType;
use gltf::accessor::{DataType, Dimensions};
use gltf::buffer::{Source, View};

use super::SceneError;
use super::budget::Budget;
use super::files::{beside, data_uri, percent_decoded, read_file};

/// Most elements of one accessor, and of all vertices of a model: 2 GB of what is made of them.
pub(super) const MAX_ELEMENTS: usize = 1 << 25;

/// The two chunks of a GLB file, and what was odd about it.
pub(super) struct Container<'a> {
    pub json: &'a [u8],
    pub binary: Option<&'a [u8]>,
    pub warnings: Vec<String>,
}

/// Splits a GLB file (glTF 2.0, chapter 4); anything without its magic number is plain JSON.
pub(super) fn split<'a>(path: &Path, bytes: &'a [u8]) -> Result<Container<'a>, SceneError> {
    let broken = |problem: String| SceneError::Broken {
        path: path.into(),
        place: "GLB container".into(),
        problem,
    };
    let mut warnings = Vec::new();
    let is_glb = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb"));
    if !bytes.starts_with(b"glTF") {
        if is_glb {
            return Err(broken("it does not begin with the letters glTF".into()));
        }
        return Ok(Container { json: bytes, binary: None, warnings });
    }
    let word = |at: usize| {
        let four = bytes.get(at..at + 4).and_then(|b| b.first_chunk::<4>());
        four.map(|b| u32::from_le_bytes(*b) as usize)
    };
    match word(4) {
        Some(2) => {}
        Some(version) => {
            return Err(broken(format!("version {version} is not 2; only glTF 2.0 is read")));
        }
        None => return Err(broken("it is cut off in the header".into())),
    }
    let length = word(8).ok_or_else(|| broken("it is cut off in the header".into()))?;
    if length > bytes.len() {
        return Err(broken(format!(
            "{length} bytes are announced, the file has {}: it is cut off",
            bytes.len()
        )));
    }
    if length < bytes.len() {
        warnings
            .push(format!("{} bytes after the end of the GLB are ignored", bytes.len() - length));
    }

    let (mut json, mut binary) = (None, None);
    let mut at = 12;
    let mut chunk = 0;
    while at < length {
        let (Some(size), Some(kind)) = (word(at), bytes.get(at + 4..at + 8)) else {
            return Err(broken(format!("chunk {chunk} is cut off in its header")));
        };
        let content = at
            .checked_add(8 + size)
            .filter(|&end| end <= length)
            .and_then(|end| bytes.get(at + 8..end))
            .ok_or_else(|| broken(format!("chunk {chunk} announces {size} bytes past the end")))?;
        match (chunk, kind) {
            (0, b"JSON") => json = Some(content),
            (0, _) => return Err(broken("the first chunk is not JSON".into())),
            (1, b"BIN\0") => binary = Some(content),
            _ => warnings.push(format!("chunk {chunk} of the GLB is of no known use and ignored")),
        }
        at += 8 + size;
        chunk += 1;
    }
    let json = json.ok_or_else(|| broken("it has no JSON chunk".into()))?;
    Ok(Container { json, binary, warnings })
}

/// An element read, what is made of it, and its copy in the scene.
const COPIES: usize = 3;

/// All buffers of a document, as long as it says they are.
pub(super) struct Buffers<'a> {
    path: &'a Path,
    pub budget: &'a Budget,
    data: Vec<Cow<'a, [u8]>>,
}

impl<'a> Buffers<'a> {
    pub fn read(
        path: &'a Path,
        document: &gltf::Document,
        binary: Option<&'a [u8]>,
        budget: &'a Budget,
    ) -> Result<Self, SceneError> {
        let mut data = Vec::new();
        for buffer in document.buffers() {
            let place = format!("buffers[{}]", buffer.index());
            let bytes = match buffer.source() {
                Source::Bin => {
                    // The chunk is the first buffer's (glTF 2.0, 4.4.3.3).
                    let chunk = binary.filter(|_| buffer.index() == 0);
                    Cow::Borrowed(chunk.ok_or_else(|| SceneError::Broken {
                        path: path.into(),
                        place: place.clone(),
                        problem: "it has no uri and is not the file's binary chunk".into(),
                    })?)
                }
                Source::Uri(uri) => {
                    let bytes = resolve(path, &place, uri)?;
                    budget.grant(uri, bytes.len());
                    budget.take(bytes.len(), 1, &place)?;
                    Cow::Owned(bytes)
                }
            };
            if bytes.len() < buffer.length() {
                return Err(SceneError::Broken {
                    path: path.into(),
                    place,
                    problem: format!("{} of {} bytes are there", bytes.len(), buffer.length()),
                });
            }
            data.push(bytes);
        }
        Ok(Self { path, budget, data })
    }

    /// The bytes of a view.
    pub fn view(&self, view: &View) -> Result<&[u8], SceneError> {
        let buffer = &self.data[view.buffer().index()];
        let range = view.offset().checked_add(view.length()).map(|end| view.offset()..end);
        range.and_then(|range| buffer.get(range)).ok_or_else(|| SceneError::Broken {
            path: self.path.into(),
            place: format!("bufferViews[{}]", view.index()),
            problem: format!(
                "bytes {} to {} + {} of a buffer that has {}",
                view.offset(),
                view.offset(),
                view.length(),
                buffer.len()
            ),
        })
    }

    /// An accessor of floats or small integers with `N` components, for instance positions.
    pub fn floats<const N: usize>(
        &self,
        accessor: &gltf::Accessor,
        use_: &str,
    ) -> Result<Vec<[f32; N]>, SceneError> {
        if accessor.dimensions().multiplicity() != N || is_matrix(accessor.dimensions()) {
            let found = format!("{:?} where {use_} need {N} components", accessor.dimensions());
            return Err(self.accessor_error(accessor, use_, found));
        }
        let data_type = accessor.data_type();
        let number: fn(&[u8]) -> f32 = match (data_type, accessor.normalized()) {
            (DataType::F32, _) => |b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            (DataType::U8, true) => |b| f32::from(b[0]) / 255.0,
            (DataType::I8, true) => |b| (f32::from(b[0] as i8) / 127.0).max(-1.0),
            (DataType::U16, true) => |b| f32::from(u16::from_le_bytes([b[0], b[1]])) / 65535.0,
            (DataType::I16, true) => {
                |b| (f32::from(i16::from_le_bytes([b[0], b[1]])) / 32767.0).max(-1.0)
            }
            // KHR_mesh_quantization: whole numbers, scaled by the node
            (DataType::U8, false) => |b| f32::from(b[0]),
            (DataType::I8, false) => |b| f32::from(b[0] as i8),
            (DataType::U16, false) => |b| f32::from(u16::from_le_bytes([b[0], b[1]])),
            (DataType::I16, false) => |b| f32::from(i16::from_le_bytes([b[0], b[1]])),
            (DataType::U32, _) => {
                let found = format!("{data_type:?}, not floats or small integers");
                return Err(self.accessor_error(accessor, use_, found));
            }
        };
        let size = data_type.size();
        let element = |bytes: &[u8]| std::array::from_fn(|i| number(&bytes[i * size..]));
        self.elements(accessor, use_, [0.0; N], element)
    }

    /// An accessor of unsigned integers.
    pub fn indices(&self, accessor: &gltf::Accessor) -> Result<Vec<u32>, SceneError> {
        let use_ = "indices";
        let number: fn(&[u8]) -> u32 = match (accessor.data_type(), accessor.dimensions()) {
            (DataType::U8, Dimensions::Scalar) => |b| u32::from(b[0]),
            (DataType::U16, Dimensions::Scalar) => |b| u32::from(u16::from_le_bytes([b[0], b[1]])),
            (DataType::U32, Dimensions::Scalar) => |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]),
            (data_type, dimensions) => {
                let found = format!("{dimensions:?} of {data_type:?}, not unsigned numbers");
                return Err(self.accessor_error(accessor, use_, found));
            }
        };
        self.elements(accessor, use_, 0, number)
    }

    /// All elements: those of the view (or `zero` without one), then the sparse ones over them.
    fn elements<T: Copy>(
        &self,
        accessor: &gltf::Accessor,
        use_: &str,
        zero: T,
        element: impl Fn(&[u8]) -> T,
    ) -> Result<Vec<T>, SceneError> {
        let count = accessor.count();
        let size = accessor.size();
        let place = format!("accessors[{}] ({use_})", accessor.index());
        if count > MAX_ELEMENTS {
            return Err(SceneError::TooLarge {
                path: self.path.into(),
                place,
                found: format!("{count} elements"),
                limit: MAX_ELEMENTS.to_string(),
                remedy: "simplify the mesh or split it into several",
            });
        }
        self.budget.take(count, COPIES * std::mem::size_of::<T>(), &place)?;
        let mut elements = match accessor.view() {
            None => vec![zero; count],
            Some(view) => {
                let stride = view.stride().unwrap_or(size);
                let bytes = self.view(&view)?;
                let places =
                    self.places(accessor, use_, bytes, accessor.offset(), stride, count)?;
                places.map(|place| element(&place[..size])).collect()
            }
        };
        let Some(sparse) = accessor.sparse() else { return Ok(elements) };

        let (at, with) = (sparse.indices(), sparse.values());
        let index: fn(&[u8]) -> usize = match at.index_type() {
            IndexType::U8 => |b| usize::from(b[0]),
            IndexType::U16 => |b| usize::from(u16::from_le_bytes([b[0], b[1]])),
            IndexType::U32 => |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]) as usize,
        };
        let index_size = match at.index_type() {
            IndexType::U8 => 1,
            IndexType::U16 => 2,
            IndexType::U32 => 4,
        };
        let (at_view, with_view) = (at.view(), with.view());
        let (at_bytes, with_bytes) = (self.view(&at_view)?, self.view(&with_view)?);
        let n = sparse.count();
        let at_places = self.places(accessor, use_, at_bytes, at.offset(), index_size, n)?;
        let with_places = self.places(accessor, use_, with_bytes, with.offset(), size, n)?;
        for (at_place, with_place) in at_places.zip(with_places) {
            let i = index(at_place);
            let slot = elements.get_mut(i).ok_or_else(|| {
                let found = format!("its sparse part replaces element {i} of {count}");
                self.accessor_error(accessor, use_, found)
            })?;
            *slot = element(&with_place[..size]);
        }
        Ok(elements)
    }

    /// `count` pieces of `bytes`, `stride` apart from `offset` on, each at least one element long.
    fn places<'b>(
        &self,
        accessor: &gltf::Accessor,
        use_: &str,
        bytes: &'b [u8],
        offset: usize,
        stride: usize,
        count: usize,
    ) -> Result<impl Iterator<Item = &'b [u8]> + use<'b>, SceneError> {
        // Sparse indices are shorter than an element: their stride is their size.
        let size = accessor.size().min(stride);
        let end = count
            .saturating_sub(1)
            .checked_mul(stride)
            .and_then(|last| last.checked_add(offset))
            .and_then(|last| last.checked_add(if count == 0 { 0 } else { size }));
        let fits = end.is_some_and(|end| end <= bytes.len());
        if !fits || stride == 0 || (stride < accessor.size() && stride > 4) {
            let found = format!(
                "{count} elements, {stride} bytes apart from byte {offset} on, in a view of {} bytes",
                bytes.len()
            );
            return Err(self.accessor_error(accessor, use_, found));
        }
        Ok((0..count).map(move |i| &bytes[offset + i * stride..]))
    }

    fn accessor_error(&self, accessor: &gltf::Accessor, use_: &str, problem: String) -> SceneError {
        let name = accessor.name().map(|name| format!(" {name:?}")).unwrap_or_default();
        SceneError::Broken {
            path: self.path.into(),
            place: format!("accessors[{}]{name} ({use_})", accessor.index()),
            problem,
        }
    }
}

fn is_matrix(dimensions: Dimensions) -> bool {
    matches!(dimensions, Dimensions::Mat2 | Dimensions::Mat3 | Dimensions::Mat4)
}

/// The file beside `path` that a URI names; `None` if it holds its own bytes or names no such file.
pub(super) fn named_file(path: &Path, uri: &str) -> Option<PathBuf> {
    if uri.starts_with("data:") {
        return None;
    }
    beside(path, &percent_decoded(uri).ok()?).ok()
}

/// The bytes a URI stands for: in itself (`data:`) or in a file beside `path`.
pub(super) fn resolve(path: &Path, place: &str, uri: &str) -> Result<Vec<u8>, SceneError> {
    let shown: String = uri.chars().take(80).collect();
    let refused = |problem: String| SceneError::Reference {
        path: path.into(),
        place: place.into(),
        uri: shown.clone(),
        problem,
    };
    if let Some(data) = data_uri(uri) {
        return data.map_err(refused);
    }
    let name = percent_decoded(uri).map_err(refused)?;
    let file = beside(path, &name).map_err(refused)?;
    read_file(&file).map_err(|error| match error {
        SceneError::Read { path: file, source } => refused(format!("{}: {source}", file.display())),
        other => other,
    })
}
