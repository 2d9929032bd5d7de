//! Every rule of the format has a file that breaks only that rule, and the whole message is compared.

use crate::support::{Arrays, META, Npy, floats, meta, refusal_of, right};
use slipsense_recording::Episode;

/// The message for these arrays, without the file's name, which must lead it.
fn refusal(arrays: &Arrays) -> String {
    let message = refusal_of(Episode::from_bytes(&arrays.npz(), "a/b.npz"));
    message.strip_prefix("a/b.npz: ").expect("leads with the file").to_owned()
}

#[track_caller]
fn refused(arrays: Arrays, message: &str) {
    assert_eq!(refusal(&arrays), message);
}

#[test]
fn required_arrays_in_c_order() {
    for name in ["piezo", "xl", "xl_end", "meta"] {
        refused(right().without(name), &format!("array `{name}` is missing"));
    }
    for name in ["piezo", "xl", "xl_end", "label", "slip_true", "meta"] {
        refused(
            right().edit(name, |npy| npy.fortran_order = "True"),
            &format!("array `{name}`: is in Fortran order, must be in C order (numpy.ascontiguousarray)"),
        );
    }
}

#[test]
fn optional_arrays_and_unknown_arrays() {
    let episode = Episode::from_bytes(&right().npz(), "x").unwrap();
    assert_eq!(episode.label.as_deref(), Some(&[0, 1, 2][..]));
    let mut arrays = right();
    for name in ["label", "slip_true", "slip_fraction", "displacement_mm"] {
        arrays = arrays.without(name);
    }
    let arrays = arrays.with(Npy::new("temperature", "<c16", &[7], vec![1, 2, 3]));
    let bare = Episode::from_bytes(&arrays.npz(), "x").unwrap();
    assert_eq!((bare.label, bare.slip_true_mm_s), (None, None));
    assert_eq!((bare.slip_fraction, bare.displacement_mm), (None, None));
    assert_eq!((bare.piezo, bare.xl), (episode.piezo, episode.xl));
}

#[test]
fn dtypes() {
    for (name, right_type, wrong) in [
        ("piezo", "uint16 ('<u2')", "<i8"),
        ("piezo", "uint16 ('<u2')", ">u2"),
        ("xl", "int16 ('<i2')", "<u2"),
        ("xl_end", "uint32 ('<u4')", "<i4"),
        ("label", "uint8 ('|u1')", "|b1"),
        ("slip_true", "float32 ('<f4')", "<f8"),
        ("slip_fraction", "float32 ('<f4')", "<f2"),
        ("displacement_mm", "float32 ('<f4')", "<f8"),
        ("meta", "uint8 ('|u1')", "<U123"),
    ] {
        refused(
            right().edit(name, |npy| npy.descr = wrong),
            &format!("array `{name}`: dtype is '{wrong}', must be {right_type}"),
        );
    }
    let long =
        right().edit("piezo", |npy| npy.descr = "<V99\\\x1b[31m-and-so-on-and-so-on-and-so-on-and-so-on");
    let message = refusal(&long);
    assert!(message.contains("dtype is '<V99") && !message.contains('\x1b'), "{message}");
    assert!(message.len() < 130, "{message}");
}

#[test]
fn shapes() {
    let piezo = "must be [F, S, 32, 32] with S from 1 to 3";
    let shape = |name: &str, text: &str, bytes: usize| {
        right().edit(name, |npy| {
            npy.shape = text.to_owned();
            npy.data.resize(bytes, 0);
        })
    };
    for (name, text, bytes, shown, must) in [
        ("piezo", "(3, 32, 32)", 6144, "[3, 32, 32]", piezo),
        ("piezo", "(3, 2, 32, 31)", 11904, "[3, 2, 32, 31]", piezo),
        ("piezo", "(3, 2, 31, 32)", 11904, "[3, 2, 31, 32]", piezo),
        ("piezo", "(3, 0, 32, 32)", 0, "[3, 0, 32, 32]", piezo),
        ("piezo", "(1, 4, 32, 32)", 8192, "[1, 4, 32, 32]", piezo),
        ("piezo", "()", 2, "[]", piezo),
        ("xl", "(100, 2, 3)", 1200, "[100, 2, 3]", "must be [S, N, 3] with S = 2 as in `piezo`"),
        ("xl", "(2, 100, 6)", 2400, "[2, 100, 6]", "must be [S, N, 3] with S = 2 as in `piezo`"),
        ("xl", "(2, 300)", 1200, "[2, 300]", "must be [S, N, 3] with S = 2 as in `piezo`"),
        ("xl_end", "(2, 3)", 24, "[2, 3]", "must be [F, S] = [3, 2] as in `piezo`"),
        ("xl_end", "(6,)", 24, "[6]", "must be [F, S] = [3, 2] as in `piezo`"),
        ("label", "(2,)", 2, "[2]", "must be [F] = [3] as in `piezo`"),
        ("label", "(3, 1)", 3, "[3, 1]", "must be [F] = [3] as in `piezo`"),
        ("slip_true", "(4,)", 16, "[4]", "must be [F] = [3] as in `piezo`"),
        ("slip_fraction", "(2,)", 8, "[2]", "must be [F] = [3] as in `piezo`"),
        ("displacement_mm", "(1,)", 4, "[1]", "must be [F] = [3] as in `piezo`"),
        ("meta", "()", 1, "[]", "must be [L], the bytes of a JSON text"),
    ] {
        refused(shape(name, text, bytes), &format!("array `{name}`: shape is {shown}, {must}"));
    }
}

#[test]
fn no_frame() {
    let mut arrays = right();
    for (name, shape) in [("piezo", "(0, 2, 32, 32)"), ("xl_end", "(0, 2)"), ("label", "(0,)")] {
        arrays = arrays.edit(name, |npy| {
            npy.shape = shape.to_owned();
            npy.data.clear();
        });
    }
    for name in ["slip_true", "slip_fraction", "displacement_mm"] {
        arrays = arrays.with(floats(name, &[]));
    }
    refused(arrays, "array `piezo`: holds no frame, must hold at least one");
}

#[test]
fn elements() {
    let count = |element, count: u16| right().put("piezo", element, count.to_le_bytes());
    let end = |element, end: u32| right().put("xl_end", element, end.to_le_bytes());
    let element = ((2 * 2 + 1) * 32 + 30) * 32 + 20;
    for (arrays, message) in [
        (count(element, 4096), "`piezo`[2, 1, 30, 20] is 4096: must be at most 4095"),
        (count(1024 + 4, 1), "`piezo`[0, 1, 0, 4] is 1: must be 0, there is no taxel"),
        (end(5, 65), "`xl_end`[2, 1] is 65: must not decrease, the frame before has 66"),
        (end(4, 101), "`xl_end`[2, 0] is 101: must be at most N = 100"),
        (end(0, u32::MAX), "`xl_end`[0, 0] is 4294967295: must be at most N = 100"),
        (right().put("label", 1, [3]), "`label`[1] is 3: must be 0, 1 or 2"),
    ] {
        refused(arrays, message);
    }
    for right in [count(element, 4095), count(1024 + 5, 1)] {
        assert!(Episode::from_bytes(&right.npz(), "x").is_ok());
    }
    let equal = Episode::from_bytes(&end(5, 66).npz(), "x").unwrap();
    assert_eq!(equal.xl_batch(2, 1), &[] as &[[i16; 3]]);
}

#[test]
fn truths() {
    for (name, value, shown, rule) in [
        ("slip_true", f32::NAN, "NaN", "must be finite and not negative"),
        ("slip_true", f32::INFINITY, "inf", "must be finite and not negative"),
        ("slip_true", -0.25, "-0.25", "must be finite and not negative"),
        ("slip_fraction", f32::NAN, "NaN", "must be from 0 to 1"),
        ("slip_fraction", f32::NEG_INFINITY, "-inf", "must be from 0 to 1"),
        ("slip_fraction", -0.25, "-0.25", "must be from 0 to 1"),
        ("slip_fraction", 1.25, "1.25", "must be from 0 to 1"),
        ("displacement_mm", f32::NAN, "NaN", "must be finite"),
        ("displacement_mm", f32::NEG_INFINITY, "-inf", "must be finite"),
    ] {
        refused(right().put(name, 2, value.to_le_bytes()), &format!("`{name}`[2] is {shown}: {rule}"));
    }
}

#[test]
fn meta_text() {
    let mut bytes = right();
    bytes.at("meta").data[4] = 0xff;
    refused(bytes, "array `meta`: must be UTF-8 JSON; byte 4 is not UTF-8");
    for (json, message) in [
        ("", "must be UTF-8 JSON: EOF while parsing a value at line 1 column 0"),
        ("{\"xl_lsb_g\": NaN}", "must be UTF-8 JSON: expected value at line 1 column 14"),
        ("[1]", "must be a JSON object, {\"xl_lsb_g\": …}"),
    ] {
        refused(right().with(meta(json)), &format!("array `meta`: {message}"));
    }
}

#[test]
fn meta_numbers() {
    for (from, to, message) in [
        ("\"xl_lsb_g\": 0.00049, ", "", "`meta` key `xl_lsb_g` is missing"),
        ("\"xl_rate_hz\": 8120, ", "", "`meta` key `xl_rate_hz` is missing"),
        ("\"frame_rate_hz\": 240, ", "", "`meta` key `frame_rate_hz` is missing"),
        ("0.00049", "\"0.00049\"", "`meta` key `xl_lsb_g` must be a number"),
        ("0.00049", "0", "`meta` key `xl_lsb_g` is 0: must be positive and finite"),
        ("0.00049", "-0.5", "`meta` key `xl_lsb_g` is -0.5: must be positive and finite"),
        ("8120", "-8000", "`meta` key `xl_rate_hz` is -8000: must be positive and finite"),
        ("8120", "null", "`meta` key `xl_rate_hz` must be a number"),
        ("8120", "7759", "`meta` key `xl_rate_hz` is 7759: must be within 3 % of 8000"),
        ("8120", "8241", "`meta` key `xl_rate_hz` is 8241: must be within 3 % of 8000"),
        ("240", "0", "`meta` key `frame_rate_hz` is 0: must be positive and finite"),
        ("240", "100", "`meta` key `frame_rate_hz` is 100: must be 240"),
    ] {
        let json = META.replace(from, to);
        assert_ne!(json, META);
        refused(right().with(meta(&json)), message);
    }
    for rate in ["7760", "8240", "8e3"] {
        let json = META.replace("8120", rate);
        assert!(Episode::from_bytes(&right().with(meta(&json)).npz(), "x").is_ok(), "{rate}");
    }
}

/// Before anything is allocated.
#[test]
fn data_of_another_length_than_the_shape() {
    for shape in [
        "(4, 2, 32, 32)",
        "(2, 2, 32, 32)",
        "(1000000000000, 2, 32, 32)",
        "(9007199254740993, 2, 32, 32)",
        "(4294967296, 4294967296, 4294967296, 4294967296)",
        "(18446744073709551615, 2, 32, 32)",
    ] {
        let shown = shape.replace('(', "[").replace(')', "]");
        let message = format!("array `piezo`: shape is {shown}, but the data is 12288 bytes");
        refused(right().edit("piezo", |npy| npy.shape = shape.to_owned()), &message);
    }
}
