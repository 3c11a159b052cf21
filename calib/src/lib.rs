//! Boards, tags, intrinsics and pose through OpenCV.
