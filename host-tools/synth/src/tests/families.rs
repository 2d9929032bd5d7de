//! Every family of every stage, in an episode that slips.

use super::*;

/// One recipe for each family of each stage, named.
fn recipes() -> impl Iterator<Item = (String, Recipe)> {
    let laboratory = Recipe {
        scenario: ScenarioChoice::SixStep,
        object: ObjectChoice::Named("usb-cable".to_owned()),
        seconds: Some(6.0),
        speed_mm_s: Some(10.0),
        ..Recipe::new(11)
    };
    let places = Stage::ALL.into_iter().flat_map(|stage| (0..FAMILIES).map(move |place| (stage, place)));
    places.map(move |(stage, place)| {
        let recipe = laboratory.clone().with_family(stage, place);
        (recipe.family(stage), recipe)
    })
}

#[test]
fn every_family_grips_slips_and_sounds() {
    let mut first = None;
    for (name, recipe) in recipes() {
        let episode = generate(&recipe).unwrap();
        episode.validate().unwrap();
        let again = generate(&recipe).unwrap();
        assert!(episode == again, "{name}");
        let (no_slip, slip) = (count(&episode, labels::NO_SLIP), count(&episode, labels::SLIP));
        let levels = levels::rms_mg(&episode, 34);
        let of = |class| median(levels::of_label(&episode, &levels, class));
        let (held_mg, slip_mg) = (of(labels::NO_SLIP), of(labels::SLIP));
        let touched = |f: usize| episode.piezo(f, 0).counts().iter().filter(|&&count| count > 3).count();
        let touched: Vec<f64> = (0..episode.frames()).map(|f| touched(f) as f64).collect();
        let moved = f64::from(episode.slip_true_mm_s.as_ref().unwrap().iter().copied().fold(0.0, f32::max));
        assert!(no_slip > 60 && slip > 60, "{name}: {no_slip} frames held, {slip} of slip");
        within(format!("{name}: fastest slip, mm/s (synthetic)"), moved, 5.0..200.0);
        within("held, mg", held_mg, 1.0..500.0);
        within("slipping, mg", slip_mg, 3.0..1_000.0);
        let area = median(levels::of_label(&episode, &touched, labels::SLIP));
        within("taxels touched in slip", area, 6.0..700.0);
        // The laboratory's family of every stage is the same episode; every other is another one.
        let laboratory = recipe.families.is_laboratory() && recipe.vibration == SourceFamily::Asperities;
        let first = first.get_or_insert_with(|| episode.clone());
        assert_eq!(laboratory, *first == episode, "{name}");
    }
}
