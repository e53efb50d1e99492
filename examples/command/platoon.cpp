// Traffic on one lane: a column of cars, the first of which brakes. The last one is the ego, which reacts late.
// Build: c++ -O2 -std=c++17 -o platoon platoon.cpp. Usage: platoon SEED DELAY_S, in a folder with scenario.xml.
#include <algorithm>
#include <cmath>
#include <deque>
#include <fstream>
#include <iostream>
#include <random>
#include <sstream>
#include <string>
#include <vector>

constexpr double kStepS = 0.02, kLengthM = 4.5;

double attribute(const std::string& xml, const std::string& name) {
  const auto at = xml.find(" " + name + "=\"");
  if (at == std::string::npos) {
    std::cerr << "scenario.xml: expected the attribute " << name << "\n";
    std::exit(2);
  }
  return std::stod(xml.substr(at + name.size() + 3));
}

// Intelligent driver model, Treiber et al. 2000, eqs. 3 and 4.
double acceleration(double speed, double gap, double ahead, double headway_s) {
  const double wanted = 2.0 + std::max(0.0, speed * headway_s + speed * (speed - ahead) / (2 * std::sqrt(1.5 * 3.0)));
  return std::max(-8.0, 1.5 * (1 - std::pow(speed / 40, 4) - std::pow(wanted / std::max(gap, 0.01), 2)));
}

int main(int argc, char** argv) {
  if (argc != 3) return std::cerr << "usage: platoon SEED DELAY_S\n", 2;
  std::ifstream file("scenario.xml");
  std::stringstream text;
  text << file.rdbuf();
  const std::string xml = text.str();
  const double speed = attribute(xml, "speed"), headway_s = attribute(xml, "headway");
  const double braking = attribute(xml, "braking");
  const int cars = static_cast<int>(attribute(xml, "cars"));
  std::mt19937_64 random(std::stoull(argv[1]));
  const auto late = static_cast<std::size_t>(std::stod(argv[2]) / kStepS);

  std::vector<double> x(cars), v(cars, speed), habit(cars);
  for (int i = 0; i < cars; ++i) {
    habit[i] = headway_s * (0.9 + 0.2 * static_cast<double>(random() >> 11) / 9007199254740992.0);
    x[i] = i ? x[i - 1] - kLengthM - 2.0 - speed * habit[i] : 0.0;
  }
  std::deque<std::pair<double, double>> seen;  // gap and speed ahead, as the ego will notice them
  std::ofstream log("log.csv");
  log << "time,gap,speed\n";
  for (int step = 0; step < 1500; ++step) {
    const double now = step * kStepS, gap = x[cars - 2] - x[cars - 1] - kLengthM;
    log << now << "," << gap << "," << v[cars - 1] << "\n";
    if (gap <= 0) break;
    seen.emplace_back(gap, v[cars - 2]);
    if (seen.size() > late + 1) seen.pop_front();
    std::vector<double> a(cars);
    a[0] = now > 1.0 ? -braking : 0.0;
    for (int i = 1; i < cars - 1; ++i)
      a[i] = acceleration(v[i], x[i - 1] - x[i] - kLengthM, v[i - 1], habit[i]);
    a[cars - 1] = acceleration(v[cars - 1], seen.front().first, seen.front().second, habit[cars - 1]);
    for (int i = 0; i < cars; ++i) {
      v[i] = std::max(0.0, v[i] + a[i] * kStepS);
      x[i] += v[i] * kStepS;
    }
  }
}
