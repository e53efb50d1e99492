// The driving system of ../idm.py in C++17, as a process of its own: the protocol brink-driving/1.
//
// It keeps its lane and follows or stops for whoever is in it, or about to walk into it, and for red lights.
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <string>
#include <utility>
#include <vector>

#include "json.hpp"

namespace {

const double kPi = 3.14159265358979323846, kRunOutM = 2000, kInfinity = std::numeric_limits<double>::infinity();

struct Pose {
  double x_m, y_m, yaw_rad;
};

// The lane: straights and arcs from station 0, and straight on beyond both ends.
class Route {
 public:
  Route() = default;
  explicit Route(const Json& route) : speed_limit_mps(route["speed_limit_mps"]) {
    const auto& begin = route["start_pose"].list;
    double yaw = begin.at(2);
    Pose pose{begin[0] - kRunOutM * std::cos(yaw), begin[1] - kRunOutM * std::sin(yaw), yaw};
    std::vector<std::pair<double, double>> pieces{{kRunOutM, 0}};
    for (const Json& piece : route["pieces"].list) pieces.emplace_back(piece.list.at(0), piece.list.at(1));
    pieces.emplace_back(kRunOutM, 0);
    double station_m = -kRunOutM;
    for (auto [length_m, curvature] : pieces) {
      rows_.push_back({station_m, length_m, curvature, pose, std::cos(pose.yaw_rad), std::sin(pose.yaw_rad)});
      pose = along(rows_.back(), length_m);
      station_m = rows_.size() == 1 ? 0 : station_m + length_m;
    }
  }

  Pose pose_at(double station_m) const {
    const Row& row = rows_[row_of(station_m)];
    return along(row, station_m - row.from_m);
  }

  double curvature_at(double station_m) const { return rows_[row_of(station_m)].curvature; }

  // Returns station and offset of the nearest point of the lane, searched from a station.
  std::pair<double, double> project(double x_m, double y_m, double near_m) const {
    size_t index = row_of(near_m), came_from = rows_.size();
    while (true) {
      const Row& row = rows_[index];
      double dx = x_m - row.pose.x_m, dy = y_m - row.pose.y_m, along_m, offset_m;
      if (row.curvature == 0) {
        along_m = dx * row.cos_yaw + dy * row.sin_yaw;
        offset_m = dy * row.cos_yaw - dx * row.sin_yaw;
      } else {
        double radius_m = 1 / row.curvature, side = row.curvature > 0 ? 1 : -1;
        double from_x = dx - -radius_m * row.sin_yaw, from_y = dy - radius_m * row.cos_yaw;
        double turned = std::atan2(side * from_y, side * from_x) - (row.pose.yaw_rad - 0.5 * kPi) + kPi;
        turned = std::fmod(turned, 2 * kPi);
        along_m = ((turned < 0 ? turned + 2 * kPi : turned) - kPi) * radius_m;
        offset_m = radius_m - side * std::sqrt(from_x * from_x + from_y * from_y);
      }
      size_t next = along_m < 0 ? index - 1 : along_m > row.length_m ? index + 1 : index;
      if (next == index || next == came_from || next >= rows_.size()) return {row.from_m + along_m, offset_m};
      came_from = index;
      index = next;
    }
  }

  double speed_limit_mps = 0;

 private:
  struct Row {
    double from_m, length_m, curvature;
    Pose pose;
    double cos_yaw, sin_yaw;
  };
  std::vector<Row> rows_;

  static Pose along(const Row& row, double m) {
    const Pose& p = row.pose;
    if (row.curvature == 0) return {p.x_m + m * row.cos_yaw, p.y_m + m * row.sin_yaw, p.yaw_rad};
    double end = p.yaw_rad + row.curvature * m;
    return {p.x_m + (std::sin(end) - row.sin_yaw) / row.curvature, p.y_m - (std::cos(end) - row.cos_yaw) / row.curvature,
            end};
  }
  size_t row_of(double station_m) const {
    size_t index = 0;
    while (index + 1 < rows_.size() && rows_[index + 1].from_m <= station_m) ++index;
    return index;
  }
};

const double kAccel = 1.5, kDecel = 2, kGapM = 2.5, kSideAccel = 1.8, kWideM = 0.4, kLooksAheadS = 2.5;

class Idm {
 public:
  explicit Idm(const Json& start)
      : route_(start["route"]),
        length_m_(start["car"]["length_m"]),
        width_m_(start["car"]["width_m"]),
        wheelbase_m_(start["car"]["wheelbase_m"]),
        headway_s_(start["settings"]["headway_s"].or_else(1.4)) {}

  std::string decide(const Json& step) {
    const Json& ego = step["ego"];
    if (step["objects"]) {
      leaders_.clear();
      for (const Json& one : step["objects"].list) see(ego, one);
    }
    double speed = ego["speed_mps"], front_m = ego["station_m"] + length_m_ / 2;
    auto leaders = leaders_;
    if (const Json& light = step["light"]; light && light["state"].text != "green") {
      double line_m = light["stop_line_station_m"];
      double needed = speed * speed / 2 / std::max(line_m - front_m, 0.1);
      if (light["state"].text == "red" || needed < 3) leaders.emplace_back(line_m + 1, 0);
    }
    double wanted = free_speed(ego["station_m"]), accel = std::min(9.0, idm(speed, wanted, kInfinity, 0));
    for (auto [at_m, mps] : leaders) accel = std::min(accel, idm(speed, wanted, at_m - front_m, mps));
    char said[256];
    std::snprintf(said, sizeof said, R"({"accel_mps2":%.17g,"steer_rad":%.17g,"mode":"%s","target_speed_mps":%.17g})",
                  std::max(accel, -8.0), steer(ego), accel < -0.5 ? "follow" : "cruise", wanted);
    return said;
  }

 private:
  Route route_;
  double length_m_, width_m_, wheelbase_m_, headway_s_;
  std::vector<std::pair<double, double>> leaders_;  // station of the rear, speed along the road

  void see(const Json& ego, const Json& one) {
    double yaw = ego["yaw_rad"], cos_yaw = std::cos(yaw), sin_yaw = std::sin(yaw), ahead_m = one["x_m"], left_m = one["y_m"];
    auto [station_m, offset_m] = route_.project(ego["x_m"] + ahead_m * cos_yaw - left_m * sin_yaw,
                                                ego["y_m"] + ahead_m * sin_yaw + left_m * cos_yaw,
                                                ego["station_m"] + ahead_m);
    double turn = route_.pose_at(station_m).yaw_rad - yaw, vx = one["vx_mps"], vy = one["vy_mps"];
    double along_mps = vx * std::cos(turn) + vy * std::sin(turn), across_mps = vy * std::cos(turn) - vx * std::sin(turn);
    double reach_m = width_m_ / 2 + one["width_m"] / 2 + kWideM, soon_m = offset_m;
    if (one["label"].text == "person" && std::abs(across_mps) > 0.3) soon_m += across_mps * kLooksAheadS;
    bool is_in_way = std::abs(offset_m) < reach_m || std::abs(soon_m) < reach_m || offset_m * soon_m < 0;
    if (station_m >= ego["station_m"] && is_in_way)
      leaders_.emplace_back(station_m - one["length_m"] / 2, std::max(along_mps, 0.0));
  }

  double free_speed(double station_m) const {
    double bend = 1e-3;
    for (int ahead_m = 0; ahead_m < 25; ahead_m += 3)
      bend = std::max(bend, std::abs(route_.curvature_at(station_m + ahead_m)));
    return std::min(route_.speed_limit_mps - 0.5, std::sqrt(kSideAccel / bend));
  }

  double idm(double speed, double wanted, double gap_m, double ahead_mps) const {
    double closing = speed * (speed - ahead_mps) / 2 / std::sqrt(kAccel * kDecel);
    double desired_m = kGapM + std::max(0.0, speed * headway_s_ + closing);
    return kAccel * (1 - std::pow(speed / wanted, 4) - std::pow(desired_m / std::max(gap_m, 0.1), 2));
  }

  double steer(const Json& ego) const {
    double axle_m = wheelbase_m_ / 2, yaw = ego["yaw_rad"], cos_yaw = std::cos(yaw), sin_yaw = std::sin(yaw);
    Pose aim = route_.pose_at(ego["station_m"] - axle_m + std::max(3.5, 0.8 * ego["speed_mps"]));
    double dx = aim.x_m - ego["x_m"] + axle_m * cos_yaw, dy = aim.y_m - ego["y_m"] + axle_m * sin_yaw;
    double left_m = dy * cos_yaw - dx * sin_yaw;
    return std::atan(2 * wheelbase_m_ * left_m / (dx * dx + dy * dy));
  }
};

// The socket to Brink.
class Channel {
 public:
  explicit Channel(int fd) : fd_(fd) {}

  bool read_line(std::string& line) {
    size_t end;
    while ((end = received_.find('\n')) == std::string::npos) {
      char part[1 << 16];
      ssize_t count = read(fd_, part, sizeof part);
      if (count <= 0) return false;
      received_.append(part, count);
    }
    line = received_.substr(0, end);
    received_.erase(0, end + 1);
    return true;
  }

  void say(const std::string& name, const std::string& content) {
    std::string line = "{\"" + name + "\":" + content + "}\n";
    for (size_t sent = 0; sent < line.size();) {
      ssize_t count = write(fd_, line.data() + sent, line.size() - sent);
      if (count <= 0) std::exit(1);
      sent += count;
    }
  }

 private:
  int fd_;
  std::string received_;
};

}  // namespace

int main() {
  const char* fd = std::getenv("BRINK_DRIVING_FD");
  if (!fd) return 2;
  Channel brink(std::atoi(fd));
  brink.say("hello", R"({"protocol":"brink-driving/1","name":"IDM in C++","version":"1","needs":"objects"})");
  std::vector<Idm> driving;  // one, from the first start on
  for (std::string line; brink.read_line(line);) {
    Json message = JsonReader(line).read();
    if (message["start"]) {
      driving.assign(1, Idm(message["start"]));
      brink.say("ready", "{}");
    } else if (message["step"]) {
      brink.say("decision", driving.at(0).decide(message["step"]));
    }
  }
}
