//! The demo's `shot.toml`: what the crew wrote down on set.

use std::fmt::Write;

use crate::objects::objects;
use crate::place::{BALL_RADIUS_M, BALL_REFLECTANCE, TABLE_CENTRE, TABLE_SIZE};
use crate::sensor::PLATE;
use crate::shoot::{BALL_SCALE, ball_corner, lying_board, tag_sheet};
use crate::targets::{CORNERS, SQUARE_M, Sheet, TAG_ID, TAG_M};

/// The text of `shot.toml`.
pub fn text() -> String {
    let (x, y) = ball_corner();
    let [r, g, b] = BALL_REFLECTANCE.to_array();
    let mut text = format!(
        r#"# The demo shot: a synthetic place (see README.md), used as a photographer would use a real one.

[plate]
file = "plate.png"
exposure = {{ time_s = {time:.7}, f_number = {f_number}, iso = {iso} }}

[camera]
boards = "board_*.jpg"
board = {{ kind = "checkerboard", corners = [{across}, {down}], square_mm = {square:.1} }}

[pose]                             # a tag lay where the objects will stand
tag = {{ photo = "tag.jpg", family = "36h11", id = {TAG_ID}, size_mm = {tag:.1}, {tag_at} }}

[probe]                            # a mirror ball on the table, six exposures, from nearer by
clipped = "error"                  # the haze dims the sun: the shortest exposure holds it

[probe.ball]
photos = "ball_b*.jpg"
radius = {BALL_RADIUS_M}
at = [0.0, {BALL_RADIUS_M}, 0.0]
reflectance = [{r}, {g}, {b}]
camera = "plate"
crop = {{ x = {x}, y = {y}, scale = {BALL_SCALE} }}
pose = {{ board = {{ photo = "ball_pose_board.jpg", {board_at} }} }}

[support]                          # the table top
plane = {{ size = [{width:.3}, {depth:.3}], at = [{cx:.3}, {cy:.3}, {cz:.3}] }}
albedo = "plate"

[[local]]                          # the pot, the aloe, the board and the lemons
file = "props.glb"
"#,
        time = PLATE.seconds(),
        f_number = PLATE.f_number,
        iso = PLATE.iso,
        across = CORNERS[0],
        down = CORNERS[1],
        square = 1000.0 * SQUARE_M,
        tag = 1000.0 * TAG_M,
        tag_at = lying_at(&tag_sheet()),
        board_at = lying_at(&lying_board()),
        width = TABLE_SIZE[0],
        depth = TABLE_SIZE[1],
        cx = TABLE_CENTRE.x,
        cy = TABLE_CENTRE.y,
        cz = TABLE_CENTRE.z,
    );
    for object in objects() {
        let [x, y, z] = object.at.to_array();
        let (name, turn, scale) = (object.name, object.rotate_y_deg, object.scale);
        let _ = write!(
            text,
            "\n[[object]]\nfile = \"{name}.glb\"\nat = [{x:.3}, {y:.3}, {z:.3}]\n\
             rotate = [0.0, {turn:.1}, 0.0]\nscale = {scale:.3}\n"
        );
    }
    text + RENDER
}

/// What the demo asks of the renderer.
const RENDER: &str = r#"
[render]
error = 0.022                      # under a CPU minute; 0.01 asks for a clean picture
denoise = "auto"
"#;

/// `at`, `facing` and `up` of a sheet: the centre of a tag's square, and of a board's corner grid.
fn lying_at(sheet: &Sheet) -> String {
    let list = |v: glam::DVec3| format!("[{:.6}, {:.6}, {:.6}]", v.x, v.y, v.z);
    format!(
        "at = {}, facing = {}, up = {}",
        list(sheet.centre),
        list(sheet.facing()),
        list(sheet.up)
    )
}
