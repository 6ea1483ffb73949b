// Zones, fence and separation; see limits/zones.py, limits/fence.py and limits/separation.py.
#pragma once

#include "lines.hpp"

namespace kernel {

// The sides of the convex hull of the fence, the same for all points.
class FenceLimit : public LineLimit {
public:
    FenceLimit(Tracks tracks, std::vector<Line> sides)
        : LineLimit(std::move(tracks)), sides_(std::move(sides)) {}

protected:
    void choose_at(std::size_t point, const Point* places, Lines& lines) const override;

private:
    std::vector<Line> sides_;  // (G).
};

// Tangents of the discs that differences of UAVs stay out of.
class SeparationLimit : public LineLimit {
public:
    SeparationLimit(Tracks tracks, Reals radii)
        : LineLimit(std::move(tracks)), radii_(std::move(radii)) {}

protected:
    void choose_at(std::size_t point, const Point* places, Lines& lines) const override;

private:
    Reals radii_;  // (G).
};

// Lines to the nearest of Z polygons for each of A UAVs.
class ZoneLimit : public LineLimit {
public:
    // The polygons are (A, Z, V).
    ZoneLimit(Tracks tracks, std::vector<Point> polygons, int concerned, int most, int vertices,
              int lines);

protected:
    void choose_at(std::size_t point, const Point* places, Lines& lines) const override;

private:
    Line line_to(const Point* places, Point middle, double near, std::size_t polygon,
                 double& least) const;

    std::vector<Point> polygons_, centres_;  // (A, Z, V), (A, Z).
    int concerned_, most_, vertices_, lines_;
};

}  // namespace kernel
