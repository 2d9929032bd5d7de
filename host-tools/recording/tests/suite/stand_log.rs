//! Test stands' logs as programs and people write them, and what is refused by line and column.

use slipsense_recording::label::{StandLog, logged_knocks};

fn refused(text: &str) -> String {
    let error = StandLog::parse(text).expect_err("must be refused").to_string();
    assert!(!error.contains('\n'), "one line: {error}");
    error
}

#[test]
fn the_same_readings_however_they_are_written() {
    let plain = StandLog::parse(
        "Reading,Load [N],Travel [mm],Time [sec]\n1,0.5,0.00,0.00\n2,-1.25,0.02,0.10\n3,2,25.40,0.20\n",
    )
    .unwrap();
    assert_eq!(plain.time_s, [0.0, 0.1, 0.2]);
    assert_eq!(plain.travel_mm, [0.0, 0.02, 25.4]);
    assert_eq!(plain.load_n.as_deref(), Some(&[0.5, -1.25, 2.0][..]));
    assert!((plain.rate_hz() - 10.0).abs() < 1e-9);
    assert!(plain.without_unit.is_empty());
    for text in [
        // A byte order mark, lines before the table, carriage returns, cells at the ends.
        "\u{feff}Mark-10 F105-EM,S/N 4711\r\nOperator: M\u{fc}ller; Time: 12:30\r\n\r\nReading,Load [N],Travel [mm],Time \
         [sec],\r\n1,0.5,0.00,0.00,\r\n2,-1.25,0.02,0.10,\r\n3,2,25.40,0.20,\r\n\r\n",
        // A spreadsheet's decimal commas.
        "Reading;Load [N];Travel [mm];Time [sec]\n1;0,5;0,00;0,00\n2;-1,25;0,02;0,10\n3;2;25,40;0,20\n",
        "\"Time [sec]\",\"Travel [mm]\",\"Load [N]\"\n\"0,0\",\"0\",\"0,5\"\n\"0,1\",\"0,02\",\"-1,25\"\n\"0,2\",\"25,4\",\"2\"\n",
        // Tabs, another order, other words and units, units below.
        "Time (ms)\tPosition (mm)\tForce (N)\n0\t0\t.5\n100\t0.02\t\u{2212}1.25\n200\t25.4\t2e0\n",
        "Reading,Load,Travel,Time\n,N,mm,s\n1,0.5,0,0\n2,-1.25,0.02,0.1\n3,2,25.4,0.2\n",
    ] {
        let other = StandLog::parse(text).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert_eq!((other.time_s, other.travel_mm), (plain.time_s.clone(), plain.travel_mm.clone()));
        assert_eq!(other.load_n, plain.load_n);
    }
    let inches = StandLog::parse("Time,Travel [in]\n0,0\n0.1,0.001\n").unwrap();
    assert!((inches.travel_mm[1] - 0.0254).abs() < 1e-12);
    assert_eq!(inches.without_unit, ["Time"]);
    assert!(logged_knocks(&inches, 10.0).unwrap_err().to_string().starts_with("has no load column"));
}

#[test]
fn what_is_wrong_is_named_by_line_and_column() {
    let header = "S/N,4711\nReading,Load [N],Travel [mm],Time [sec]\n";
    for (rows, error) in [
        ("1,0,0,0\n2,0,x,0.1\n", "line 4, column \"Travel [mm]\": is \"x\", must be a number"),
        ("1,0,0,0\n2,0,0\n", "line 4, column \"Time [sec]\": is \"\", must be a number"),
        ("1,0,nan,0\n2,0,0,1\n", "line 3, column \"Travel [mm]\": is \"nan\", must be a number"),
        ("1,0,\"1,234.5\",0\n2,0,0,1\n", "line 3, column \"Travel [mm]\": is \"1,234.5\", must be a number"),
        ("1,0,0,0\n\n\n2,0,x,0.1\n", "line 6, column \"Travel [mm]\": is \"x\", must be a number"),
        ("1,0,0,0\r\n2,0,0,0\r\n3,0,x,0.1\r\n", "line 5, column \"Travel [mm]\": is \"x\", must be a number"),
        (
            "1,0,0,0.2\n2,0,0,0.1\n",
            "line 4, column \"Time [sec]\": is \"0.1\", must not be before the reading above",
        ),
        (
            "1,0,0,0\n2,0,1,0.5\n",
            "line 4: 0.50 s after the reading above, and the crosshead moved 1.00 mm: readings must be at most \
             0.2 s apart while it moves",
        ),
        (
            "1,0,0,0,02\n2,0,0,0,04\n",
            "line 3: 5 cells, must be 4 as in the header; where numbers have decimal commas, cells must be \
             separated by semicolons or tabs",
        ),
        ("1,0,0,0\n", "line 3: 1 readings follow, must be at least two at different times"),
    ] {
        assert_eq!(refused(&format!("{header}{rows}")), error);
    }
    for text in ["", "1,2,3\n", "Reading,Load [N],Time [sec]\n1,2,3\n", "PK\u{3}\u{4}"] {
        assert!(refused(text).starts_with("no line of the first 200 names the columns"), "{text}");
    }
    let error = refused("Time [s],Travel [pt]\n0,0\n");
    assert!(error.starts_with("line 1: column \"Travel [pt]\": unit must be"), "{error}");
}

/// 100 readings per second, 2 s of rest, 1 s at 5 mm/s, 2 s of rest.
fn one_pull() -> StandLog {
    let rows = (0..500).map(|i| {
        let t = f64::from(i) / 100.0;
        format!("{t:.2},{:.4}\n", 5.0 * (t - 2.0).clamp(0.0, 1.0))
    });
    StandLog::parse(&("Time [s],Travel [mm]\n".to_owned() + &rows.collect::<String>())).unwrap()
}

#[test]
fn readings_become_positions_at_frames() {
    let log = one_pull();
    let at = log.at_frames(480, 1.5).unwrap();
    assert_eq!(at.held_frames, 0);
    for (frame, &mm) in at.displacement_mm.iter().enumerate() {
        let t = (frame as f64 + 1.0) / 240.0 + 1.5;
        assert!((f64::from(mm) - 5.0 * (t - 2.0).clamp(0.0, 1.0)).abs() < 1e-3, "frame {frame}: {mm}");
    }
    // A second before the first reading and some after the last one: the crosshead stood.
    let wide = log.at_frames(240 * 8, -1.0).unwrap();
    assert_eq!((wide.displacement_mm[0], *wide.displacement_mm.last().unwrap()), (0.0, 5.0));
    // Ticks before 0 s, and after 4.99 s on its clock, which is 5.99 s = 1437.6 frames from the start.
    assert_eq!(wide.held_frames, 239 + (240 * 8 - 1437));
}

#[test]
fn a_log_that_does_not_cover_the_recording_is_refused() {
    let log = one_pull();
    for offset_s in [-10.0, 100.0] {
        let error = log.at_frames(480, offset_s).unwrap_err().to_string();
        assert!(error.starts_with("covers 0.000 s to 4.990 s, but the recording lasts from"), "{error}");
    }
    // The log may end within a pull, but no more than a reading before the recording does.
    let pulled = StandLog::parse("Time [s],Travel [mm]\n0,0\n0.1,1\n0.2,2\n0.3,3\n").unwrap();
    assert_eq!(pulled.at_frames(96, -0.05).unwrap().held_frames, 11 + 12);
    let error = pulled.at_frames(97, 0.0).unwrap_err().to_string();
    assert!(error.starts_with("the crosshead moves at the last"), "{error}");
    let moving = "Time [s],Travel [mm]\n0,0\n0.1,1\n0.2,2\n0.3,2\n0.6,2\n";
    let error = StandLog::parse(moving).unwrap().at_frames(100, -0.2).unwrap_err().to_string();
    let rule = "the crosshead moves at the first reading (0.000 s), must stand there";
    assert!(error.starts_with(rule), "{error}");
}
