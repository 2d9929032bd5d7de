//! The border to the page's JavaScript: one instance of the module shows one recording.
//!
//! JavaScript hands bytes over by asking for room ([`input`]) and writing them there; what a function has to say lies at
//! [`output`], as many bytes as it returns.

use std::cell::RefCell;
use std::io::Cursor;

use slipsense::net::{Aligned, Model};
use slipsense::wire::NodeId;
use slipsense_recording::EpisodeReader;

use crate::frames::{Frames, Session};
use crate::record::Record;
use crate::source;

static MODEL: &[u8] = &Aligned(*include_bytes!("../../../model/weights/slipsense.slipnet")).0;
static EPISODE: &[u8] = include_bytes!("../../cli/demo/episode.npz");

const ZIP: &[u8] = b"PK";
const MCAP: &[u8] = b"\x89MCAP";
const BUNDLED: &str = "bundled";

struct Viewed {
    frames: Frames,
    records: Box<dyn Iterator<Item = Result<Record, String>>>,
}

thread_local! {
    static INPUT: RefCell<Vec<Vec<u8>>> = const { RefCell::new(Vec::new()) };
    static OUTPUT: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
    static VIEWED: RefCell<Option<Viewed>> = const { RefCell::new(None) };
}

/// Room for the next input.
// SAFETY: no other function of the module has this name; likewise below.
#[unsafe(no_mangle)]
pub extern "C" fn input(length: usize) -> *mut u8 {
    INPUT.with_borrow_mut(|inputs| {
        inputs.push(vec![0; length]);
        inputs.last_mut().map_or(std::ptr::null_mut(), Vec::as_mut_ptr)
    })
}

// SAFETY: see `input`.
#[unsafe(no_mangle)]
pub extern "C" fn output() -> *const u8 {
    OUTPUT.with_borrow(Vec::as_ptr)
}

fn say(bytes: Vec<u8>) -> usize {
    let length = bytes.len();
    OUTPUT.set(bytes);
    length
}

/// Inputs: the recording's name and bytes, the model's name and bytes; the bundled ones where a name is empty. The
/// output is what is wrong with them, empty if nothing is.
// SAFETY: see `input`.
#[unsafe(no_mangle)]
pub extern "C" fn open(node: u8) -> usize {
    let inputs: Result<[Vec<u8>; 4], _> = INPUT.take().try_into();
    let Ok(inputs) = inputs else { return say(b"four inputs are needed".to_vec()) };
    match view(inputs, node) {
        Ok(viewed) => {
            VIEWED.set(Some(viewed));
            say(Vec::new())
        }
        Err(problem) => say(problem.into_bytes()),
    }
}

fn view([name, bytes, model_name, model_bytes]: [Vec<u8>; 4], node: u8) -> Result<Viewed, String> {
    let mut name = String::from_utf8_lossy(&name).into_owned();
    let bytes = if name.is_empty() { EPISODE.into() } else { bytes };
    if name.is_empty() {
        name = "bundled episode".into();
    }
    let session;
    let records: Box<dyn Iterator<Item = _>> = if bytes.starts_with(ZIP) {
        // An instance lives as long as its recording: nothing is freed before.
        let file = EpisodeReader::new(Cursor::new(bytes), &name).map_err(|error| error.to_string())?;
        let file = Box::leak(Box::new(file));
        let mut model_name = String::from_utf8_lossy(&model_name).into_owned();
        let model: &'static [u8] = if model_name.is_empty() { MODEL } else { Box::leak(model_bytes.into()) };
        if model_name.is_empty() {
            model_name = BUNDLED.into();
        }
        let model = Model::parse(model).map_err(|error| format!("model {model_name}: {error}"))?;
        session = Session::of_episode(name.clone(), model_name, file.episode());
        let records = source::episode(file, model).map_err(|problem| format!("{name}: {problem}"))?;
        Box::new(records.map(|record| record.map_err(|problem| problem.to_string())))
    } else if bytes.starts_with(MCAP) {
        return Err(format!(
            "{name}: an MCAP recording; `slipsense convert` makes an episode of it, which can be shown"
        ));
    } else {
        let node = NodeId::new(node).ok_or_else(|| format!("node {node}: no address of a module"))?;
        session = Session::of_log(name.clone(), false);
        let records = source::log(Cursor::new(bytes), node);
        Box::new(
            records.map(|record| record.map_err(|error| format!("no episode (.npz), and as a log: {error}"))),
        )
    };
    let mut records = records.peekable();
    match records.peek() {
        Some(Ok(_)) => Ok(Viewed { frames: Frames::new(session, usize::MAX), records: Box::new(records) }),
        Some(Err(problem)) => Err(format!("{name}: {problem}")),
        None => Err(format!("{name}: no message of node {node}")),
    }
}

/// Take `count` frames; 0: there are no more.
// SAFETY: see `input`.
#[unsafe(no_mangle)]
pub extern "C" fn advance(count: u32) -> u32 {
    VIEWED.with_borrow_mut(|viewed| {
        let Some(Viewed { frames, records }) = viewed else { return 0 };
        for _ in 0..count {
            match records.next() {
                Some(Ok(record)) => frames.push(&record),
                end => {
                    if !frames.state().ended {
                        frames.end(end.and_then(Result::err));
                    }
                    return 0;
                }
            }
        }
        1
    })
}

/// Input: a request of [`Frames::answer`]. Output: the number of its first frame in eight bytes, and the body.
// SAFETY: see `input`.
#[unsafe(no_mangle)]
pub extern "C" fn answer() -> usize {
    let request = INPUT.take().pop().unwrap_or_default();
    let request = String::from_utf8_lossy(&request);
    let answer = VIEWED.with_borrow(|viewed| viewed.as_ref()?.frames.answer(&request));
    let Some(answer) = answer else { return say(Vec::new()) };
    say([&answer.first.unwrap_or(0).to_le_bytes()[..], &answer.body].concat())
}
